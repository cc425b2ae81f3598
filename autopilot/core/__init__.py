"""Shared definitions: messages, frames, parameters, geometry, the vehicle model and errors. Imports no other package."""

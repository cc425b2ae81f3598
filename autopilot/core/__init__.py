"""Shared definitions: messages, frames, parameters, geometry, vehicle model, errors. Imports no other package."""

"""Shared vocabulary: messages, frames, parameters, geometry, the vehicle model and errors. Imports nothing of ours."""

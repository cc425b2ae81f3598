"""Clients of a link, as links and service both number them."""

EVERYONE = 0
"""The client number of all who are at the other end of a link."""

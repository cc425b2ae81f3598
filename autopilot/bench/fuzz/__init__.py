"""Whatever may come over a wire or out of a sensor, into the real service: nothing of it may end or bend it."""

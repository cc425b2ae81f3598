"""One pure function per fixed-size message that packs it.

Each function takes the stamp in nanoseconds (the log's epoch plus the service's clock) first and returns CDR bytes.
Topics of variable size (paths, markers, transforms, images, text) are in :mod:`autopilot.log.visuals`.
"""

"""What failures of a disk are called in front of an operator."""

import errno

_CAUSES = {
    errno.ENOSPC: "disk full",
    errno.EDQUOT: "disk full",
    errno.EFBIG: "file too large",
    errno.EROFS: "disk read-only",
    errno.EACCES: "no right to write",
    errno.EPERM: "no right to write",
    errno.ENOENT: "folder gone",
    errno.ENOTDIR: "folder gone",
    errno.EEXIST: "folder gone",
    errno.EIO: "disk broken",
}


def cause_of(error: Exception) -> str:
    """A failure of the disk, or an error that comes from one, in two or three words."""
    found = error if isinstance(error, OSError) else error.__cause__
    if isinstance(found, OSError):
        return _CAUSES.get(found.errno or 0, str(found.strerror).lower())
    return str(error)

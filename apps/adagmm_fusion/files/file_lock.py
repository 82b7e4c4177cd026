"""An open file is one process's: by flock where there is one, else by Windows's locks of bytes."""

import os
from typing import Any

fcntl: Any
msvcrt: Any
try:
    import fcntl
except ImportError:
    fcntl = None
try:
    import msvcrt
except ImportError:
    msvcrt = None

# Windows lets nobody else read or write what is locked: one byte, far behind the end of the files that are.
FAR_BYTE = 2**30


def lock(descriptor: int) -> bool:
    """Lock an open file for this process, until it is closed; whether nobody else had it.

    Raises
    ------
    OSError  where the file system cannot lock it.
    """
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
    if msvcrt is None:
        return True
    here = os.lseek(descriptor, 0, os.SEEK_CUR)
    os.lseek(descriptor, FAR_BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except PermissionError:
        return False
    finally:
        os.lseek(descriptor, here, os.SEEK_SET)
    return True

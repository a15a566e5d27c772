"""A file that is opened once and read again and again."""

from __future__ import annotations

import os
import stat

from linkrover.errors import LinkRoverError
from linkrover.records import Unknown

_CHUNK = 65536


class SourceUnavailableError(LinkRoverError):
    """A source cannot be read now; `reason` is what the record will say."""

    def __init__(self, source: str, reason: Unknown, detail: str = "") -> None:
        self.source = source
        self.reason = reason
        super().__init__(f"{source}: {reason.value}" + (f" ({detail})" if detail else ""))


def reason_of(error: OSError) -> Unknown:
    """Why a value is unknown, from the error of the call that should have given it."""
    if isinstance(error, PermissionError):
        return Unknown.NOT_PERMITTED
    if isinstance(error, FileNotFoundError):
        return Unknown.ABSENT
    return Unknown.UNSUPPORTED


class KeptFile:
    """Keeps a file descriptor open and reads the whole file with pread.

    A descriptor under /proc/.../net stays in the network namespace it was opened in. A regular file that was
    replaced (renamed over) or removed is opened anew.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._fd = -1
        self._regular = False

    def read(self) -> bytes:
        """The file's content now.

        Raises:
            SourceUnavailableError: it cannot be opened or read; the next call tries again.
        """
        try:
            if self._fd >= 0 and self._regular and os.fstat(self._fd).st_nlink == 0:
                self.close()
            if self._fd < 0:
                self._open()
            data = os.pread(self._fd, _CHUNK, 0)
            if not data:
                return data
            # A sequence file gives a page at a time: only an empty read is the end.
            parts, offset = [data], len(data)
            while data := os.pread(self._fd, _CHUNK, offset):
                parts.append(data)
                offset += len(data)
            return parts[0] if len(parts) == 1 else b"".join(parts)
        except OSError as error:
            self.close()
            raise SourceUnavailableError(self.path, reason_of(error), error.strerror or "") from error

    def close(self) -> None:
        """Give back the descriptor; read() opens it again."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _open(self) -> None:
        # O_NONBLOCK: a named pipe given by mistake must not stop the measuring
        self._fd = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        self._regular = stat.S_ISREG(os.fstat(self._fd).st_mode) and not self.path.startswith(("/proc/", "/sys/"))

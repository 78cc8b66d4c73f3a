"""Objects of the library, owned by objects of Python."""

from __future__ import annotations

from types import TracebackType
from typing import Any, TypeVar

from ._library import ffi, scalar
from .errors import Error

_Self = TypeVar("_Self", bound="Handle")


class Handle:
    """What owns an object of the library. A context manager: closed where its block ends."""

    # Of the class, so that close() works on what was never made.
    _handle: Any = ffi.NULL

    def _own(self, kind: str, destroy: Any, create: Any, *inputs: Any) -> None:
        """Owns the ``kind`` that ``create`` makes of ``inputs``."""
        self._handle = ffi.gc(scalar(f"{kind} *", create, *inputs), destroy)

    def close(self) -> None:
        """Frees it now, and not when nobody refers to it any more. Every later use raises.

        A call that is still running in another thread keeps it until that call is over.
        """
        self._handle = ffi.NULL

    def __enter__(self: _Self) -> _Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        try:
            says = "closed" if self._handle == ffi.NULL else self._says()
        except Error as error:  # in use by another thread, for instance
            says = error.status
        return f"<cophase.{type(self).__name__}: {says}>"

    def _says(self) -> str:
        """What there is to know of it, in a line."""
        raise NotImplementedError

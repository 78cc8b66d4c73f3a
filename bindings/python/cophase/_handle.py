"""Objects of the library, owned by objects of Python."""

from __future__ import annotations

from types import TracebackType
from typing import Any, TypeVar

from ._interrupt import interruptible
from ._library import ffi, lib, result
from .errors import Error

_Self = TypeVar("_Self", bound="Handle")


class Handle:
    """Owner of an object of the library. As a context manager, it is closed at the end of its block."""

    # An attribute of the class, so that close() works if __init__ failed.
    _handle: Any = ffi.NULL
    # What makes an equal object in another process, if anything does: a class and its arguments.
    _recipe: tuple[Any, tuple[Any, ...]] | None = None
    # What to send to another process instead.
    _instead = "send what it is made from"

    def _own(self, kind: str, create: Any, *inputs: Any) -> None:
        """Owns the ``kind`` that ``create`` makes of ``inputs``. Ctrl-C ends it within two seconds."""
        made = []

        def call() -> None:
            made.append(ffi.gc(result(f"{kind} *", create, *inputs), getattr(lib, f"{kind}_destroy")))

        interruptible(call)
        self._handle = made[0]

    def close(self) -> None:
        """Frees the object now, rather than with the last reference to it. Every later call raises.

        A call that is still running in another thread keeps the object until it returns.
        """
        self._handle = ffi.NULL

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        if self._recipe is None or self._handle == ffi.NULL:
            state = "" if self._recipe is None else "closed "
            raise TypeError(f"a {state}cophase.{type(self).__name__} does not pickle: {self._instead}")
        return self._recipe

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
            line = "closed" if self._handle == ffi.NULL else self._summary()
        except Error as error:  # in use by another thread, for instance
            line = error.status
        return f"<cophase.{type(self).__name__}: {line}>"

    def _summary(self) -> str:
        """The object in a line."""
        raise NotImplementedError

"""Ctrl-C during a long call."""

from __future__ import annotations

import threading
from concurrent.futures import Future, TimeoutError
from contextlib import suppress
from typing import Callable

from .errors import Error

#: How often a watched call is looked at, s.
_LOOK_S = 0.1


def interruptible(
    call: Callable[[], None], cancel: Callable[[], None], watch: Callable[[], None] | None = None
) -> None:
    """Makes a call that Ctrl-C cancels; ``watch`` is called now and then until it is over.

    Python handles a signal in the main thread alone, and only between its own instructions: so that thread must wait in
    Python while another one is inside the library. What ``watch`` raises cancels the call as well.
    """
    if watch is None and threading.current_thread() is not threading.main_thread():
        call()
        return
    done: Future[None] = Future()

    def work() -> None:
        try:
            call()
            done.set_result(None)
        except BaseException as error:  # noqa: BLE001 - for the thread that waits
            done.set_exception(error)

    thread = threading.Thread(target=work, name="cophase")
    try:
        thread.start()
        _wait(done, watch)
    except BaseException as error:
        if thread.ident is None or (done.done() and done.exception() is error):  # never begun, or the call's own
            raise
        cancel()
        if thread.is_alive():
            thread.join()
        if done.done() and done.exception() is None:
            # It was over before it could be cancelled, and the next one must not be in its place.
            with suppress(Error):
                call()
        raise


def _wait(done: Future[None], watch: Callable[[], None] | None) -> None:
    while watch is not None and not done.done():
        with suppress(TimeoutError):
            done.exception(_LOOK_S)
        watch()
    done.result()

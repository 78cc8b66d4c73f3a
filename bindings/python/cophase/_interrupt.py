"""Ctrl-C during a long call."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from contextlib import suppress
from typing import Callable

from .errors import Error

# Longest time that Ctrl-C waits for a call to end at its next safe place. A call that goes on, as the set-up of a large telescope does,
# ends in its own thread, and what it makes is freed.
PATIENCE_S = 2.0


def interruptible(call: Callable[[], None], cancel: Callable[[], None] | None = None) -> None:
    """Makes a call that Ctrl-C ends, by ``cancel`` where the library can stop it.

    Python handles a signal in the main thread only, and only between its own instructions. So the main thread waits in
    Python while another thread is inside the library.
    """
    if threading.current_thread() is not threading.main_thread():
        call()
        return
    done: Future[None] = Future()
    # Guards both flags: a call that has ended is not cancelled.
    lock, flags = threading.Lock(), {"ended": False, "cancelled": False}

    def work() -> None:
        try:
            call()
            with lock:
                flags["ended"] = True
            if flags["cancelled"]:
                # The call ended before it reached a safe place; the cancellation must not fall on the next one.
                with suppress(Error):
                    call()
            done.set_result(None)
        except BaseException as error:  # noqa: BLE001 - raised again by the thread that waits
            done.set_exception(error)

    # A process that ends does not wait for it.
    thread = threading.Thread(target=work, name="cophase", daemon=True)
    try:
        thread.start()
        done.result()
    except BaseException as error:
        if thread.ident is None or (done.done() and done.exception() is error):  # not started, or the call's own error
            raise
        with lock:
            if cancel is not None and not flags["ended"]:
                flags["cancelled"] = True
                cancel()
        thread.join(PATIENCE_S)
        raise

"""Ctrl-C during a long call."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from contextlib import suppress
from typing import Callable

from .errors import Error


def interruptible(call: Callable[[], None], cancel: Callable[[], None]) -> None:
    """Makes a call that Ctrl-C cancels.

    Python handles a signal in the main thread only, and only between its own instructions. So the main thread waits in
    Python while another thread is inside the library.
    """
    if threading.current_thread() is not threading.main_thread():
        call()
        return
    done: Future[None] = Future()

    def work() -> None:
        try:
            call()
            done.set_result(None)
        except BaseException as error:  # noqa: BLE001 - raised again by the thread that waits
            done.set_exception(error)

    thread = threading.Thread(target=work, name="cophase")
    try:
        thread.start()
        done.result()
    except BaseException as error:
        if thread.ident is None or (done.done() and done.exception() is error):  # not started, or the call's own error
            raise
        cancel()
        if thread.is_alive():
            thread.join()
        if done.done() and done.exception() is None:
            # The call ended before it could be cancelled; the cancellation must not fall on the next one.
            with suppress(Error):
                call()
        raise

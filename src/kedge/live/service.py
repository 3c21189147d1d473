"""The thread that drives a fleet, and what it shares with the tasks of a web server."""

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from kedge.core.errors import DataError, KedgeError
from kedge.live.frame import encode
from kedge.live.simulated import STEP, Fleet

COMMANDS = 100
"""How many may wait."""


class Service:
    """Steps a fleet at ``speed`` times its own pace, and hands every frame to listeners.

    Listeners are called from its thread.
    """

    def __init__(self, fleet: Fleet, speed: float = 1.0):
        self.fleet, self.speed = fleet, speed
        self.frames, self.failure = 0, None
        self.newest: float | None = None
        """When the newest frame was made, by ``time.monotonic``."""
        self.statuses: list[str] = []
        self._listeners = set[Callable[[bytes], None]]()
        self._commands: queue.Queue[dict[str, Any]] = queue.Queue(COMMANDS)
        self._ends, self._thread = threading.Event(), threading.Thread(target=self._run)

    def start(self) -> None:
        """Begin; the fleet is the thread's own from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread, and wait for it."""
        self._ends.set()
        self._thread.join()

    def listen(self, listener: Callable[[bytes], None]) -> Callable[[], None]:
        """Give every frame to a listener until what is returned is called."""
        self._listeners = self._listeners | {listener}

        def leave() -> None:
            self._listeners = self._listeners - {listener}

        return leave

    def command(self, message: Any) -> None:
        """What a page asks for, before the next step.

        Raises:
            DataError: it is of no form that is known, or too many wait.
        """
        if not isinstance(message, dict) or not {"fault", "stop"} & set(message):
            raise DataError('expected an object with "fault" or "stop"')
        try:
            self._commands.put_nowait(message)
        except queue.Full:
            raise DataError(f"{COMMANDS} commands wait already: send fewer") from None

    def obey(self, message: dict[str, Any]) -> None:
        """Do what a message says; from the fleet's thread only.

        Raises:
            DataError: it names nothing that there is.
        """
        if "stop" in message:
            self.fleet.stop(message["stop"])
            return
        fault = message["fault"]
        if not isinstance(fault, dict):
            raise DataError(f"fault: found {fault!r}, expected an object")
        self.fleet.inject(
            fault.get("vehicle"), fault.get("kind"), fault.get("source"), fault.get("seconds")
        )

    def turn(self) -> None:
        """Do what waits, then one step."""
        while not self._commands.empty():
            try:
                self.obey(self._commands.get_nowait())
            except KedgeError as error:
                print(f"refused: {error}", flush=True)
        frame = encode(self.fleet.step(), self.frames)
        self.frames, self.newest = self.frames + 1, time.monotonic()
        self.statuses = [one.status.value for one in self.fleet.engine.vehicles]
        for listener in self._listeners:
            listener(frame)

    def _run(self) -> None:
        due = time.monotonic()
        try:
            while not self._ends.is_set():
                self.turn()
                # After a pause it goes on from now, and does not hurry.
                due = max(due + STEP / self.speed, time.monotonic() - 1.0)
                self._ends.wait(max(0.0, due - time.monotonic()))
        except Exception as error:
            self.failure = f"{type(error).__name__}: {error}"
            raise

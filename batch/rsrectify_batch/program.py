# SPDX-License-Identifier: MIT OR Apache-2.0

"""Calls of the program `rsrectify`."""

import json
import shutil
import subprocess
import sys
import threading
from importlib.util import find_spec
from typing import Any, ClassVar

# What the program exits with where a clip fails, with the reason, and where the command line cannot be carried out.
FAILED = 1
USAGE = 2


# What it is called where nothing else is said.
NAME = "rsrectify"


class ProgramError(Exception):
    """A call that failed: what the program said, and its exit code."""

    def __init__(self, message: str, code: int):
        super().__init__(message, code)
        self.message = message
        self.code = code

    @property
    def is_final(self) -> bool:
        """Whether the program itself has given up: it would for the same reason on another try, unless it was interrupted or
        killed."""
        return self.code in (FAILED, USAGE)

    def __str__(self) -> str:
        return self.message


class Program:
    """The program under a name or path."""

    # Processes that run, of all calls in this Python process.
    _running: ClassVar[set[subprocess.Popen[str]]] = set()
    _lock = threading.Lock()

    def __init__(self, path: str):
        self.path = path

    def run(self, *arguments: object) -> str:
        """What a call writes to its standard output; `ProgramError` where it fails."""
        command = [*self._command(), *map(str, arguments)]
        # A call must not outlive the worker that waits for it: another worker tries the same again.
        if shutil.which("setpriv"):
            command = ["setpriv", "--pdeathsig", "KILL", *command]
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        with self._lock:
            self._running.add(process)
        try:
            output, errors = process.communicate()
        finally:
            with self._lock:
                self._running.discard(process)
        if process.returncode != 0:
            raise ProgramError(_reason(errors) or f"it ended with {process.returncode}", process.returncode)
        return output

    def _command(self) -> list[str]:
        """How it is started."""
        if shutil.which(self.path):
            return [self.path]
        # A wheel holds both, and its environment need not be on PATH.
        if self.path == NAME and find_spec("rsrectify_program"):
            return [sys.executable, "-m", "rsrectify_program"]
        raise ProgramError(f"{self.path}: no such program", USAGE)

    def json(self, *arguments: object) -> Any:
        """The same of a call that writes JSON."""
        return json.loads(self.run(*arguments))

    @classmethod
    def stop_all(cls) -> None:
        """Ends what runs."""
        with cls._lock:
            for process in cls._running:
                process.terminate()


def _reason(errors: str) -> str:
    """The last error that the program named."""
    lines = [line for line in errors.splitlines() if line.startswith("error: ")] or errors.split("\n\n")
    return lines[-1].removeprefix("error: ").strip()

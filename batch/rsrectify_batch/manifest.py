# SPDX-License-Identifier: MIT OR Apache-2.0

"""The state of a run, in a JSON file from which it goes on after a break."""

import fcntl
import json
import os
import time
from pathlib import Path
from typing import Any

NAME = "rsrectify-batch.json"
# Version of the file's form.
VERSION = 1
# Seconds between two writings: what is lost with a broken run is done again.
INTERVAL = 1.0


class ManifestError(Exception):
    """A run that cannot go on from what there is."""


class Manifest:
    """What a run has done so far: `options` that change the result, and by clip what is known and written."""

    def __init__(self, folder: Path, options: dict[str, Any], afresh: bool):
        self.path = folder / NAME
        self.options = options
        self.clips: dict[str, dict[str, Any]] = {}
        self._written = 0.0
        # The folder itself is locked: a file for it would be left by a broken run.
        self._lock = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ManifestError(f"another run writes to {folder}") from error
        if self.path.exists() and not afresh:
            self._read()

    def _read(self) -> None:
        state = read(self.path.parent)
        changed = [name for name, value in self.options.items() if state["options"].get(name) != value]
        if changed:
            raise ManifestError(
                f"{self.path} is of a run with other options ({', '.join(changed)}): give the same, another --output, or --afresh"
            )
        self.clips = state["clips"]

    def clip(self, clip: str, output: str) -> dict[str, Any]:
        """What is known of a clip; nothing where the file is another one since."""
        identity: dict[str, Any] = {"output": output}
        # One that is gone fails by itself, and the others are done.
        if os.path.exists(clip):
            status = os.stat(clip)
            identity |= {"size": status.st_size, "modified_ns": status.st_mtime_ns}
        known = self.clips.get(clip)
        if known is None or any(known.get(name) != value for name, value in identity.items()):
            known = {**identity, "state": "waiting"}
            self.clips[clip] = known
        return known

    def save(self, now: bool = False) -> None:
        """Writes the file, unless that was a moment ago."""
        if not now and time.monotonic() - self._written < INTERVAL:
            return
        state = {"version": VERSION, "options": self.options, "clips": self.clips}
        unfinished = self.path.with_suffix(".part")
        with open(unfinished, "w") as file:
            json.dump(state, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, self.path)
        self._written = time.monotonic()

    def close(self) -> None:
        self.save(now=True)
        os.close(self._lock)


def read(folder: Path) -> dict[str, Any]:
    """The state of a run that writes, or has written, to a folder."""
    path = folder / NAME
    try:
        state: Any = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise ManifestError(f"{folder}: no run has written there") from error
    except (OSError, ValueError) as error:
        raise ManifestError(f"{path} cannot be read: {error}") from error
    if not isinstance(state, dict) or state.get("version") != VERSION:
        raise ManifestError(f"{path} is of another version of this program")
    return state

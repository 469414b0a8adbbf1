# SPDX-License-Identifier: MIT OR Apache-2.0

"""What a run does with what its steps report, without the program."""

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rsrectify_batch.cli import _done
from rsrectify_batch.executors import WorkerLost
from rsrectify_batch.program import Program, ProgramError
from rsrectify_batch.run import Run, Settings


class Failing:
    """An executor of whose attempts at a step all fail but the third."""

    slots = 1

    def __init__(self, error: Exception):
        self.error = error
        self.attempts = 0

    async def run(self, step: str, arguments: tuple[Any, ...]) -> dict[str, Any]:
        self.attempts += 1
        if self.attempts < 3:
            raise self.error
        return {}


def attempts(error: Exception) -> int:
    """How often a step is carried out that fails twice."""
    executor = Failing(error)
    manifest: Any = SimpleNamespace(path=Path("out/manifest.json"))
    progress: Any = SimpleNamespace(say=lambda line: None)
    run = Run([], Settings(), executor, manifest, progress)
    try:
        asyncio.run(run.step("fix", "rsrectify", "clip.mp4"))
    except type(error):
        assert executor.attempts < 3
    return executor.attempts


# Killed by a signal, interrupted, and panicked.
@pytest.mark.parametrize("code", [-9, 130, 101])
def test_what_did_not_come_to_its_end_is_tried_again(code: int) -> None:
    assert attempts(ProgramError("it ended", code)) == 3
    assert attempts(WorkerLost("gone")) == 3


@pytest.mark.parametrize("code", [1, 2])
def test_what_the_program_refuses_is_not_tried_again(code: int) -> None:
    assert attempts(ProgramError("there is no video in the file", code)) == 1


def test_a_finished_clip_of_one_part_is_counted() -> None:
    one, two = {"first": 0, "end": 30}, {"first": 30, "end": 60}
    assert _done({"state": "done", "parts": [one]}).strip() == "1 of 1 parts rectified"
    written = {**one, "result": {"bytes": 9}}
    assert _done({"state": "waiting", "parts": [written, two]}).strip() == "1 of 2 parts rectified"
    assert _done({"state": "waiting", "measured": [{**one, "found": {}}, two]}).strip() == "1 of 2 parts measured"
    assert _done({"state": "waiting"}).strip() == "0 of 0 parts measured"


def test_a_program_that_is_not_on_path_is_that_of_the_wheel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ProgramError, match="no such program"):
        Program("rsrectify").run("--version")
    package = tmp_path / "rsrectify_program"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text("import sys; print(sys.argv[1:])")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert Program("rsrectify").run("--version").strip() == "['--version']"
    with pytest.raises(ProgramError, match="no such program"):
        Program("another").run("--version")

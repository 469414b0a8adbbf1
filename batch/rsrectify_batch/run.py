# SPDX-License-Identifier: MIT OR Apache-2.0

"""A run: all clips, each from its index to the checked file.

    index → measure parts → combine → (motion file →) rectify parts → join

Clips go through it side by side, and so do the parts of each, as many at a time as there are workers. What is done is in the
manifest, and is not done again.
"""

import asyncio
import shutil
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

from . import readout
from .executors import WorkerLost
from .manifest import Manifest
from .plan import Part, parts
from .program import ProgramError
from .progress import Progress

# Where parts are kept until they are joined, below the output.
WORK = ".rsrectify-batch"


@dataclass(frozen=True)
class Job:
    """A clip, and the file that it becomes."""

    clip: str
    output: str
    # As the file will have it; none of a clip that cannot be opened.
    codec: str | None


@dataclass(frozen=True)
class Settings:
    """How clips are rectified."""

    program: str = "rsrectify"
    # Frames of a part, about; and frames before it that are analysed too.
    part: int = 600
    halo: int = 60
    # Whether all clips were made by one camera in one mode.
    same_camera: bool = False
    # The readout as options of `rsrectify fix`, where it is given.
    readout: list[str] = field(default_factory=list)
    # Options of `rsrectify measure`, of `rsrectify fix`, and of both `rsrectify fix` and `rsrectify join`.
    measure_options: list[str] = field(default_factory=list)
    fix_options: list[str] = field(default_factory=list)
    join_options: list[str] = field(default_factory=list)
    # Whether the motion of each clip is found at one go, and kept in a file beside its result.
    motion: bool = False
    # Options of `rsrectify track`; with a motion file, `fix_options` has none of the analysis.
    track_options: list[str] = field(default_factory=list)
    # Processors of each rectifier.
    processors: int = 1
    # How often a step that fails is tried again.
    retries: int = 2

    @property
    def all_fix_options(self) -> list[str]:
        # With any number of threads the pixels are the same.
        return [*self.fix_options, "--threads", str(self.processors)]


class Clip:
    """A clip on its way."""

    def __init__(self, job: Job, known: dict[str, Any], folder: Path, has_motion: bool):
        self.job = job
        # Its entry of the manifest.
        self.known = known
        name = sha256(job.clip.encode()).hexdigest()[:16]
        self.folder = folder / WORK / f"{Path(job.clip).stem}-{name}"
        self.index = str(self.folder / "index.json")
        # The clip's whole name, as two of one folder may differ in their extension only.
        self.motion = str(Path(job.output).with_name(f"{Path(job.clip).name}.motion")) if has_motion else None

    @property
    def has_motion(self) -> bool:
        """Whether its motion file is written, where there is to be one."""
        return self.motion is None or _has_size(self.motion, self.known.get("motion"))

    @property
    def is_done(self) -> bool:
        result = self.known.get("result")
        return self.known["state"] == "done" and _has_size(self.job.output, result) and self.has_motion

    @property
    def in_the_way(self) -> str | None:
        """A file under the name of one that is to be written, which no run has written."""
        is_new = "index" not in self.known or self.known["state"] == "done"
        files = [file for file in (self.job.output, self.motion) if file and Path(file).exists()]
        return files[0] if is_new and not self.is_done and files else None

    @property
    def measurements(self) -> list[dict[str, Any]]:
        return [one["found"] for one in self.known.get("measured", []) if one.get("found")]

    @property
    def cuts(self) -> list[int]:
        return sorted({cut for found in self.measurements for cut in found.get("cuts", []) if cut > 0})

    def output_of(self, part: Part) -> str:
        # Matroska states the time of each frame, where MP4's edit lists may end before the last one. But of ProRes, GStreamer's
        # demuxer of it does not give the times out.
        ending = ".mov" if self.job.codec == "prores" else ".mkv"
        return str(self.folder / f"{part.first:07}{ending}")


class Executor(Protocol):
    """Carries steps out, `slots` of them at a time."""

    slots: int

    async def run(self, step: str, arguments: tuple[Any, ...]) -> dict[str, Any]: ...


class Run:
    """Rectifies clips by an executor."""

    def __init__(self, jobs: list[Job], settings: Settings, executor: Executor, manifest: Manifest, progress: Progress):
        folder = manifest.path.parent
        self.settings = settings
        self.executor = executor
        self.manifest = manifest
        self.progress = progress
        self.clips = [Clip(job, manifest.clip(job.clip, job.output), folder, settings.motion) for job in jobs]
        # Each clip that is begun has a step to do: with as many of them as there are slots no worker is idle, and no more
        # parts than needed wait to be joined.
        self._begun = asyncio.Semaphore(executor.slots)
        self._slots = asyncio.Semaphore(executor.slots)

    async def all(self) -> list[Clip]:
        """Rectifies all clips; those that failed."""
        waiting = [clip for clip in self.clips if not clip.is_done]
        for clip in self.clips:
            clip.known.pop("error", None)
            self.progress.knows(clip)
        if self.settings.same_camera and not self.settings.readout:
            # The readout is known when all of them are measured.
            await self._each(waiting, self.measure)
            measured = [clip for clip in self.clips if "error" not in clip.known]
            common = readout.combine([one for clip in measured for one in clip.measurements])
            self.progress.say(f"readout of all clips: {common}")
            waiting = [clip for clip in waiting if "error" not in clip.known]
            for clip in waiting:
                self.tell(clip, common)
            await self._each(waiting, self.rectify)
        else:
            await self._each(waiting, self.measure_and_rectify)
        return [clip for clip in self.clips if "error" in clip.known]

    async def _each(self, clips: list[Clip], task: Callable[[Clip], Awaitable[None]]) -> None:
        await asyncio.gather(*(self._one(clip, task) for clip in clips))

    async def _one(self, clip: Clip, task: Callable[[Clip], Awaitable[None]]) -> None:
        """Has a task done for a clip; a clip that fails does not stop the others."""
        async with self._begun:
            try:
                await task(clip)
            except (ProgramError, WorkerLost, OSError) as error:
                # The program names the clip, too.
                reason = str(error).removeprefix(f"{clip.job.clip}: ")
                clip.known.update(state="failed", error=reason)
                self.progress.say(f"error: {clip.job.clip}: {reason}")
            self.manifest.save()

    async def measure_and_rectify(self, clip: Clip) -> None:
        await self.measure(clip)
        if not self.settings.readout and "readout" not in clip.known:
            found = readout.combine(clip.measurements)
            self.progress.say(f"{clip.job.clip}: readout {found}")
            self.tell(clip, found)
        await self.rectify(clip)

    async def measure(self, clip: Clip) -> None:
        """Lists a clip's frames and measures its parts."""
        known, program = clip.known, self.settings.program
        if "index" not in known or not Path(clip.index).exists():
            clip.folder.mkdir(parents=True, exist_ok=True)
            known["index"] = await self.step("index", program, clip.job.clip, clip.index)
            self.progress.knows(clip)
            # From now on a file under the output's name is the run's own.
            self.manifest.save(now=True)
        if self.settings.readout:
            return
        planned = parts(known["index"]["frames"], self.settings.part)
        known.setdefault("measured", [part.entry for part in planned])
        await _all(self._measure(clip, one) for one in known["measured"] if "found" not in one)

    async def _measure(self, clip: Clip, one: dict[str, Any]) -> None:
        part = Part.of(one)
        options = self.settings.measure_options
        one["found"] = await self.step("measure", self.settings.program, clip.job.clip, clip.index, part, options)
        self.progress.done(part.frames)
        self.manifest.save()

    def tell(self, clip: Clip, found: readout.Readout | None) -> None:
        """Has all parts of a clip rectified with one readout."""
        options = found.options([*self.settings.fix_options, *self.settings.track_options]) if found else readout.OPEN
        told = {"options": options, "said": str(found)}
        if clip.known.get("readout") != told:
            # What was rectified with another one is of no use.
            for one in ("parts", "motion"):
                clip.known.pop(one, None)
            clip.known["readout"] = told

    async def rectify(self, clip: Clip) -> None:
        """Rectifies the parts of a clip and joins them."""
        known, settings, job = clip.known, self.settings, clip.job
        frames = known["index"]["frames"]
        told = settings.readout or known["readout"]["options"]
        known.setdefault("parts", [part.entry for part in parts(frames, settings.part, clip.cuts)])
        common = (settings.program, job.clip, clip.index)
        Path(job.output).parent.mkdir(parents=True, exist_ok=True)
        if settings.motion:
            told = await self._track(clip, told)
        if len(known["parts"]) == 1:
            options = [*told, *settings.all_fix_options, *settings.join_options]
            known["result"] = await self.step("fix_all", *common, frames, job.output, options)
            self.progress.done(frames)
        else:
            await _all(self._fix(clip, one, told) for one in known["parts"] if not self._has(clip, one))
            files = [clip.output_of(Part.of(one)) for one in known["parts"]]
            known["result"] = await self.step("join", *common, files, job.output, settings.join_options)
            self._compare(clip)
        known["state"] = "done"
        self.manifest.save(now=True)
        shutil.rmtree(clip.folder, ignore_errors=True)
        self.progress.say(f"{job.output}: {frames} frames")

    async def _track(self, clip: Clip, told: list[str]) -> list[str]:
        """Writes the motion of a clip to a file; the options by which `rsrectify fix` applies it."""
        known, frames = clip.known, clip.known["index"]["frames"]
        if not clip.has_motion:
            # What was rectified by another file is of no use.
            for one in known["parts"]:
                one.pop("result", None)
            options = [*told, *self.settings.track_options]
            known["motion"] = await self.step("track", self.settings.program, clip.job.clip, frames, clip.motion, options)
            self.manifest.save(now=True)
        self.progress.done(frames)
        return ["--motion", str(clip.motion)]

    def _has(self, clip: Clip, one: dict[str, Any]) -> bool:
        part = Part.of(one)
        is_there = _has_size(clip.output_of(part), one.get("result"))
        if is_there:
            self.progress.done(part.frames)
        return is_there

    async def _fix(self, clip: Clip, one: dict[str, Any], told: list[str]) -> None:
        part, settings = Part.of(one), self.settings
        output, options = clip.output_of(part), [*told, *settings.all_fix_options]
        if clip.job.codec and not any(option.startswith("--codec") for option in options):
            # What the file can hold, which the part could hold more than.
            options.append(f"--codec={clip.job.codec}")
        # With a motion file nothing is analysed.
        halo = 0 if settings.motion else settings.halo
        one["result"] = await self.step(
            "fix", settings.program, clip.job.clip, clip.index, part, halo, output, options
        )
        self.progress.done(part.frames)
        self.manifest.save()

    def _compare(self, clip: Clip) -> None:
        """Whether the parts that were joined are those that were written."""
        joined = clip.known["result"]["parts"]
        written = [one["result"]["sha256"] for one in clip.known["parts"]]
        for one, found, expected in zip(clip.known["parts"], joined, written):
            if found != expected:
                Path(clip.job.output).unlink(missing_ok=True)
                # To be written again by the next run.
                one.pop("result")
        if joined != written:
            raise ProgramError("a part was changed after it was written", 1)

    async def step(self, name: str, *arguments: Any) -> dict[str, Any]:
        """Has a step carried out, again where it did not come to its end."""
        for attempt in range(self.settings.retries + 1):
            async with self._slots:
                try:
                    return await self.executor.run(name, arguments)
                except (ProgramError, WorkerLost) as error:
                    is_final = isinstance(error, ProgramError) and error.is_final
                    if is_final or attempt == self.settings.retries:
                        raise
                    self.progress.say(f"{name} of {arguments[1]} is tried again: {error}")
        raise AssertionError("a step is tried at least once")


async def _all(tasks: Iterable[Awaitable[None]]) -> None:
    """Waits for all tasks, so that none goes on when the clip has failed; then raises the first error."""
    results = await asyncio.gather(*tasks, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result


def _has_size(file: str, result: dict[str, Any] | None) -> bool:
    path = Path(file)
    return result is not None and path.exists() and path.stat().st_size == result["bytes"]

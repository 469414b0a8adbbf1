# SPDX-License-Identifier: MIT OR Apache-2.0

"""Runs of the whole package with the program on this machine."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import (
    FILM,
    FRAMES,
    PART,
    READOUT_ERROR_MS,
    READOUT_MS,
    Output,
    fix,
    index,
    pixels,
    readout_said,
    sha256_of_frames,
)

READOUT = ("--readout-time", "26.7", "--readout-direction", "top-to-bottom")


def test_a_film_in_parts_has_the_frames_and_times_of_the_clip(output: Output) -> None:
    said = output.run(FILM, options=("--codec", "ffv1"))
    assert "1 of 1 clips rectified" in said
    assert abs(readout_said(said, "film.mp4: readout") - READOUT_MS) < READOUT_ERROR_MS
    clip = output.manifest["clips"][str(FILM)]
    # A shot begins at a cut, which one of the measured parts found; the readout is one for all parts.
    assert [part["found"]["cuts"] for part in clip["measured"]] == [[15], [], [], []]
    assert len(clip["parts"]) > 3 and clip["parts"][0]["end"] == 15
    found, expected = index(output.folder / "film-rectified.mkv"), index(FILM)
    assert found["frames"] == FRAMES == expected["frames"]
    # Matroska's clock ticks every millisecond.
    assert all(abs(a - b) <= 1e6 for a, b in zip(found["times_ns"], expected["times_ns"]))
    assert output.files == ["film-rectified.mkv"]


def test_bytes_do_not_depend_on_the_workers(output: Output, tmp_path: Path) -> None:
    output.run(FILM, options=("--workers", "3", *READOUT))
    clip = output.manifest["clips"][str(FILM)]
    # The same parts by the program alone, one after another.
    files = []
    (tmp_path / "alone").mkdir()
    for part in clip["parts"]:
        files.append(tmp_path / "alone" / f"{part['first']:03}.mkv")
        frames = ("--frames", f"{part['first']}:{part['end']}", "--audio", "none")
        fix(FILM, files[-1], *READOUT, *frames)
        assert sha256_of_frames(files[-1]) == part["result"]["sha256"]
    assert sum(index(file)["frames"] for file in files) == FRAMES
    assert clip["result"]["sha256"] == sha256_of_frames(output.folder / "film-rectified.mp4")


def test_a_clip_of_one_part_is_what_the_program_makes_of_it(output: Output, tmp_path: Path) -> None:
    output.run(FILM, options=("--part", "600", *READOUT))
    fix(FILM, tmp_path / "alone.mp4", *READOUT)
    assert sha256_of_frames(output.folder / "film-rectified.mp4") == sha256_of_frames(tmp_path / "alone.mp4")


def _as_it_was(folder: Path) -> Path:
    """The film, without loss."""
    fix(FILM, folder / "still.mkv", "--codec", "ffv1", "--strength", "0", *READOUT)
    return folder / "still.mkv"


def test_a_motion_file_beside_the_result_is_what_was_applied(output: Output, tmp_path: Path) -> None:
    options = ("--motion", "--codec", "ffv1", *READOUT, "--fix", "--border-mode", "mirror", "--lookahead", "3")
    output.run(FILM, options=options)
    assert output.files == ["film-rectified.mkv", "film.mp4.motion"]
    clip = output.manifest["clips"][str(FILM)]
    assert len(clip["parts"]) == FRAMES // PART
    # The parts, joined, are what the program makes of the whole film, with the file and without.
    written, file = output.folder / "film-rectified.mkv", output.folder / "film.mp4.motion"
    given = ("--codec", "ffv1", "--border-mode", "mirror")
    fix(FILM, tmp_path / "applied.mkv", "--motion", file, *given)
    fix(FILM, tmp_path / "alone.mkv", *READOUT, "--lookahead", "3", *given)
    expected = pixels(tmp_path / "alone.mkv")
    assert len(expected) > FRAMES * 320 * 240 and expected != pixels(_as_it_was(tmp_path))
    assert pixels(written) == expected and pixels(tmp_path / "applied.mkv") == expected
    # Nobody's file is replaced; a file of this run that is gone is written again, with what was made by it.
    before = file.read_bytes()
    file.unlink()
    output.run(FILM, options=("--overwrite", *options))
    assert file.read_bytes() == before and pixels(written) == expected
    file.write_text("mine")
    written.unlink()
    assert "film.mp4.motion is there already" in output.run(FILM, options=("--afresh", *options), code=2)
    assert file.read_text() == "mine"


def test_a_steadied_clip_in_parts_is_that_of_its_motion_file(output: Output, tmp_path: Path) -> None:
    steadied = ("--stabilize", "0.3", *READOUT)
    output.run(FILM, options=(*steadied, "--motion", "--codec", "ffv1"))
    fix(FILM, tmp_path / "whole.mkv", *steadied, "--codec", "ffv1", "--container", "mkv")
    assert pixels(output.folder / "film-rectified.mkv") == pixels(tmp_path / "whole.mkv")


def test_motion_files_of_measured_clips(output: Output, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    archive.mkdir()
    for name in ("one.mp4", "one.mov", "broken.mov"):
        shutil.copy(FILM, archive / name)
    (archive / "broken.mov").write_text("no video")
    said = output.run(archive, options=("--motion", "--part", "600", "--fix", "--model", "rotation"), code=1)
    assert "2 of 3 clips rectified" in said
    written = [name for name in output.files if not name.startswith(".rsrectify-batch")]
    assert written == ["one-rectified.mov", "one-rectified.mp4", "one.mov.motion", "one.mp4.motion"]
    files = [(output.folder / f"one.{ending}.motion").read_bytes()[:1024].decode() for ending in ("mp4", "mov")]
    assert all(f"\nframes: {FRAMES}\n" in header for header in files)
    assert "\nclip: one.mov\n" in files[1]


def test_an_archive_keeps_its_folders_and_a_bad_clip_stops_no_other(output: Output, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    for folder in ("one", "two/deep"):
        (archive / folder).mkdir(parents=True)
        shutil.copy(FILM, archive / folder / "GX010001.MP4")
    (archive / "one" / "broken.mov").write_text("no video")
    said = output.run(archive, options=("--part", "600", "--same-camera", "--retries", "1"), code=1)
    assert "2 of 3 clips rectified" in said
    assert abs(readout_said(said, "readout of all clips:") - READOUT_MS) < READOUT_ERROR_MS
    assert "failed" in said and "broken.mov" in said
    written = [name for name in output.files if name.endswith("-rectified.MP4".lower())]
    assert written == ["one/GX010001-rectified.mp4", "two/deep/GX010001-rectified.mp4"]
    # Mended, the same command does only what is left.
    shutil.copy(FILM, archive / "one" / "broken.mov")
    before = (output.folder / written[0]).stat().st_mtime_ns
    output.run(archive, options=("--part", "600", "--same-camera", "--retries", "1"))
    assert (output.folder / written[0]).stat().st_mtime_ns == before
    assert "one/broken-rectified.mov" in output.files and ".rsrectify-batch" not in output.files


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_broken_run_goes_on_where_it_was(output: Output, how: signal.Signals) -> None:
    options = ("--workers", "1", *READOUT)
    process = output.start(FILM, options=options)
    parts = output.folder / ".rsrectify-batch"
    deadline = time.monotonic() + 60
    while len(done := list(parts.rglob("???????.mkv"))) < 2:
        assert time.monotonic() < deadline and process.poll() is None, process.communicate()
        time.sleep(0.02)
    process.send_signal(how)
    process.wait(timeout=20)
    if how == signal.SIGINT:
        assert process.returncode == 130
        assert all(len(file.name) == len("0000000.mkv") for file in parts.rglob("*.mkv")), output.files
    # A part that the manifest, which is written once a second, does not name yet is done again.
    times = {file: file.stat().st_mtime_ns for file in done}
    named = {one["first"] for one in output.manifest["clips"][str(FILM)].get("parts", []) if "result" in one}
    said = output.run(FILM, options=options)
    assert "1 of 1 clips rectified" in said
    for one in output.manifest["clips"][str(FILM)]["parts"]:
        assert "result" in one
    assert named or how == signal.SIGKILL
    assert times and output.files == ["film-rectified.mp4"]
    assert index(output.folder / "film-rectified.mp4")["frames"] == FRAMES


def test_a_part_that_was_changed_is_noticed_and_done_again(output: Output) -> None:
    # Without a place to write the result, the run ends with its parts.
    output.folder.mkdir()
    blocked = output.folder / "film-rectified.mp4"
    blocked.mkdir()
    output.run(FILM, options=("--overwrite", "--retries", "0", *READOUT), code=1)
    parts = sorted((output.folder / ".rsrectify-batch").rglob("???????.mkv"))
    assert len(parts) == FRAMES // PART
    # Another part of the same length and size in bytes would pass for it.
    changed = bytearray(parts[1].read_bytes())
    changed[len(changed) // 3] ^= 0xFF
    parts[1].write_bytes(changed)
    blocked.rmdir()
    said = output.run(FILM, options=("--overwrite", "--retries", "0", *READOUT), code=1)
    assert "changed after it was written" in said
    assert output.files[-1] != "film-rectified.mp4"
    output.run(FILM, options=("--overwrite", *READOUT))
    assert output.files == ["film-rectified.mp4"]


def test_what_cannot_be_asked_for_is_refused(output: Output, tmp_path: Path) -> None:
    for options, reason in [
        (("--program", "no-such-program"), "no such program"),
        (("--codec", "vp8"), "vp8"),
        (("--codec", "prores", "--container", "mp4"), "MP4"),
        (("--part", "0"), "at least 1"),
        (("--readout-time", "soon"), "invalid float"),
        (("--readout-time", "-5"), "readout-time"),
        (("--camera", "Pinhole 3"), "no such camera is known"),
        (("--fix", "--strength", "7"), "strength"),
    ]:
        said = output.run(FILM, options=options, code=2)
        assert reason in said and "Traceback" not in said, said
    said = output.run(tmp_path / "none.mp4", code=1)
    assert "cannot be read" in said or "No such file" in said
    (output.folder / "film-rectified.mp4").write_text("mine")
    assert "--overwrite" in output.run(FILM, options=("--afresh",), code=2)
    assert (output.folder / "film-rectified.mp4").read_text() == "mine"


def test_a_run_with_other_options_does_not_mix_with_the_first(output: Output) -> None:
    output.run(FILM, options=("--part", "600", *READOUT))
    # Nor does it replace what somebody else has put there.
    written = output.folder / "film-rectified.mp4"
    whole = written.read_bytes()
    written.write_text("mine")
    assert "--overwrite" in output.run(FILM, options=("--part", "600", *READOUT), code=2)
    written.write_bytes(whole)
    said = output.run(FILM, options=("--part", "600", "--readout-time", "10"), code=2)
    assert "other options (readout)" in said
    state = output.manifest
    (output.folder / "rsrectify-batch.json").write_text(json.dumps({**state, "version": 99}))
    assert "another version" in output.run(FILM, options=("--part", "600", *READOUT), code=2)
    (output.folder / "rsrectify-batch.json").write_text("{")
    assert "cannot be read" in output.run(FILM, options=("--part", "600", *READOUT), code=2)


def test_a_page_has_the_numbers_of_all_clips(output: Output, tmp_path: Path) -> None:
    bad = tmp_path / "<b>bad.mp4"
    bad.write_text("no video")
    output.run(FILM, bad, options=READOUT, code=1)
    (output.folder / "film.mp4.page").mkdir()
    (output.folder / "film.mp4.page" / "index.html").touch()
    said = subprocess.run([sys.executable, "-m", "rsrectify_batch", "report", output.folder], check=True, capture_output=True)
    page = (output.folder / "rsrectify-batch.html").read_text()
    assert said.stdout.decode().strip() == str(output.folder / "rsrectify-batch.html")
    assert "1 of 2 clips rectified" in page and "<b>" not in page and "&lt;b&gt;bad.mp4" in page
    row = next(line for line in page.splitlines() if "film-rectified.mp4" in line)
    assert '<a href="film-rectified.mp4">' in row and '<a href="film.mp4.page/index.html">' in row
    assert f'<td class="number">{FRAMES}<' in row and "26.7 ms, top-to-bottom, as given" in row
    clip = output.manifest["clips"][str(FILM)]
    summaries = [part["result"]["summary"] for part in clip["parts"]]
    assert sum(one["frames"] for one in summaries) == FRAMES
    share = sum(one["corrected_frames"] for one in summaries) / FRAMES
    largest = max(one["correction_px"]["largest"] for one in summaries)
    assert share > 0.9 and f">{100 * share:.0f}<" in row and f">{largest:.1f}<" in row
    status = subprocess.run([sys.executable, "-m", "rsrectify_batch", "status", output.folder], check=True, capture_output=True)
    assert f"{share:.0%} of the frames corrected" in status.stdout.decode()

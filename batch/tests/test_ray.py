# SPDX-License-Identifier: MIT OR Apache-2.0

"""A Ray cluster of several nodes on this machine, one of which is killed."""

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import FILM, FRAMES, PROGRAM, Output, index

ray_cluster = pytest.importorskip("ray.cluster_utils")
# Many parts.
OPTIONS = ("--part", "10", "--halo", "10", "--readout-time", "26.7", "--readout-direction", "top-to-bottom")


@pytest.fixture
def cluster() -> Iterator[Any]:
    # The head only keeps the books; each other node has one worker.
    made = ray_cluster.Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    made.workers = [made.add_node(num_cpus=1) for _ in range(3)]
    made.wait_for_nodes()
    yield made
    made.shutdown()


@pytest.fixture
def held(tmp_path: Path) -> SimpleNamespace:
    """The program, all of whose parts but the first are begun and then wait for `go`: how fast a machine is does not tell which
    of its workers are at work when one is killed."""
    program, begun, go = tmp_path / "held", tmp_path / "begun", tmp_path / "go"
    begun.mkdir()
    program.write_text(
        f"""#!/usr/bin/env bash
if [[ $1 == fix && $* == *" --frames "* && $* != *" --frames 0:"* ]]; then
  touch {begun}/$$
  timeout 120 bash -c 'until [[ -e {go} ]]; do sleep 0.02; done'
fi
exec {PROGRAM} "$@"
"""
    )
    program.chmod(0o755)
    return SimpleNamespace(program=program, begun=begun, go=go)


def test_nothing_is_lost_with_a_node(cluster: Any, output: Output, tmp_path: Path, held: SimpleNamespace) -> None:
    process = output.start(
        FILM, options=("--address", cluster.address, "--retries", "3", *OPTIONS, "--program", held.program)
    )
    # Each node has begun a part.
    work = output.folder / ".rsrectify-batch"
    deadline = time.monotonic() + 120
    while not (list(work.rglob("???????.mkv")) and len(list(held.begun.iterdir())) >= len(cluster.workers)):
        assert time.monotonic() < deadline and process.poll() is None, process.communicate()
        time.sleep(0.01)
    cluster.remove_node(cluster.workers[1], allow_graceful=False)
    said = ""
    assert process.stdout
    while "is tried again" not in said:
        line = process.stdout.readline()
        said += line
        assert line, said
    held.go.touch()
    rest, _ = process.communicate(timeout=500)
    assert process.returncode == 0, said + rest

    film = output.folder / "film-rectified.mp4"
    assert index(film)["frames"] == FRAMES
    # What one process on this machine makes of it, to the byte.
    alone = type(output)(tmp_path / "alone")
    alone.run(FILM, options=("--workers", "1", *OPTIONS))
    ours, theirs = (one.manifest["clips"][str(FILM)] for one in (output, alone))
    assert [part["result"]["sha256"] for part in ours["parts"]] == [part["result"]["sha256"] for part in theirs["parts"]]
    assert index(film)["sha256"] == index(alone.folder / "film-rectified.mp4")["sha256"]
    assert output.files == ["film-rectified.mp4"]


def test_a_cluster_that_is_not_there_is_an_error(output: Output) -> None:
    said = output.run(FILM, options=("--address", "127.0.0.1:1", *OPTIONS), code=2)
    assert "Ray" in said and "Traceback" not in said

"""A Dask cluster makes the same files as this process, whatever becomes of its workers and of who asks."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from gated_stand_in import Gated, Noting
from set_files import contents
from stand_in import Hungry, StandIn

from pepperscene.dataset import build, open_dataset
from pepperscene.dataset.execution import dask_cluster as crew
from pepperscene.dataset.execution import dask_dispatch as shift
from pepperscene.dataset.execution import dask_worker as afar
from pepperscene.dataset.recipe.plan import frame_seed
from pepperscene.errors import InputError, OutputError, WorkerError

distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")

OUTPUTS = ("class", "distance")
HERE = str(Path(__file__).parent)

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals end processes here")


@contextmanager
def local_cluster(workers, preload=(), **variables):
    """Worker processes on this machine, with a renderer that takes some time.

    Args:
        workers: how many.
        preload: Python that each runs first.
        variables: of their environment.
    """
    before = dict(os.environ)
    os.environ.update({"PYTHONPATH": HERE, "STAND_IN_S": "0.05", **{k: str(v) for k, v in variables.items()}})
    try:
        with distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",
            silence_logs=50,
            preload=list(preload),
        ) as cluster:
            yield cluster
    finally:
        os.environ.clear()
        os.environ.update(before)


@pytest.fixture(scope="module")
def notes(tmp_path_factory):
    return tmp_path_factory.mktemp("notes") / "notes.txt"


@pytest.fixture(scope="module")
def cluster(notes):
    with local_cluster(2, NOTES=notes) as cluster:
        yield cluster


@pytest.fixture
def make(recipe, tmp_path):
    def run(out="set", renderer=StandIn, **arguments):
        return build(recipe, tmp_path / out, renderer=renderer, outputs=OUTPUTS, **arguments)

    return run


def rendered(notes):
    """Process and seed of every frame that somebody began to render, in that order."""
    return (
        [tuple(map(int, line.split())) for line in notes.read_text().splitlines()] if notes.exists() else []
    )


def until(condition, patience_s=30.0):
    end = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
    return found


def test_one_worker_of_four_killed_twice(make, recipe, tmp_path, monkeypatch):
    notes, gate = tmp_path / "notes.txt", tmp_path / "gate"
    whole_at_kill, notices, told = [], [], []

    def kill(nanny, seeds):
        """End the worker's process once it is at a frame; the nanny starts another one."""
        process = until(lambda: nanny.pid if any(pid == nanny.pid for pid, _ in rendered(notes)) else None)
        os.kill(process, signal.SIGKILL)
        until(lambda: nanny.pid != process)
        whole = {seeds[index] for index in open_dataset(tmp_path / "set").indices()}
        whole_at_kill.append((whole, len(rendered(notes))))

    def kill_twice(cluster):
        seeds = {index: frame_seed(recipe.seed, index) for index in range(24)}
        nanny = until(
            lambda: next((one for one in cluster.workers.values() if one.pid in dict(rendered(notes))), None)
        )
        kill(nanny, seeds)
        kill(nanny, seeds)
        gate.touch()

    with local_cluster(4, NOTES=notes, GATE=gate) as cluster:
        killer = threading.Thread(target=kill_twice, args=(cluster,), daemon=True)

        def begin(progress):
            told.append(progress.index)
            if len(told) == 1:
                killer.start()

        done = make(
            "set",
            Gated,
            scheduler=cluster.scheduler_address,
            on_frame=begin,
            on_notice=notices.append,
        )
        killer.join()

    # Complete, and told once each; what the killed one had finished but not told of yet was found there.
    assert sorted((*done.made, *done.kept)) == list(range(24))
    assert len(done.kept) <= 2
    assert sorted(told) == list(range(24))
    # No frame twice in the tables.
    rows = done.dataset.manifest().to_pylist()
    assert [row["index"] for row in rows] == list(range(24))
    lines = (tmp_path / "set" / "journal.jsonl").read_text().splitlines()
    frames = [row["index"] for row in map(json.loads, lines) if "index" in row]
    assert sorted(frames) == list(range(24))
    # Both losses were told, and what was whole then was not rendered again.
    assert len(notices) == 2
    assert all("a worker was lost over frame 0000" in notice for notice in notices)
    for whole, place in whole_at_kill:
        assert not whole & {seed for _, seed in rendered(notes)[place:]}
    # Identical to an undisturbed build in one process.
    monkeypatch.setenv("NOTES", str(tmp_path / "others.txt"))
    make("alone", Noting)
    assert contents(tmp_path / "alone") == contents(tmp_path / "set")


def test_a_cluster_makes_the_same_files(make, cluster, tmp_path):
    told = []
    shared = make("shared", scheduler=cluster.scheduler_address, on_frame=told.append)
    make("alone")
    assert contents(tmp_path / "alone") == contents(tmp_path / "shared")
    assert sorted(one.index for one in told) == list(shared.made) == list(range(24))
    assert len({row["worker"] for row in shared.dataset.manifest().to_pylist()}) == 2
    again = make("shared", scheduler=cluster.scheduler_address)
    assert (again.made, again.kept) == ((), tuple(range(24)))
    assert not list(tmp_path.rglob(".*"))


def test_workers_keep_to_their_threads(make, cluster):
    make(scheduler=cluster.scheduler_address, frames="0:1")
    with distributed.Client(cluster, set_as_default=False) as client:
        told = client.run(lambda: os.environ.get("PEPPERSCENE_THREADS")).values()
    assert "1" in told
    assert set(told) <= {"1", None}


def test_an_interrupt_ends_the_tasks_and_leaves_the_cluster(make, cluster, notes, tmp_path):
    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make("set", Noting, scheduler=cluster.scheduler_address, on_frame=stop)
    begun = len(rendered(notes))
    dataset = open_dataset(tmp_path / "set")
    there = dataset.indices()
    # Nobody is at a frame any more.
    time.sleep(0.3)
    assert len(rendered(notes)) == begun
    assert dataset.indices() == there
    assert 3 <= len(there) < 24
    assert [row["index"] for row in dataset.manifest().to_pylist()] == list(there)
    assert len(cluster.scheduler.workers) == 2
    assert not cluster.scheduler.tasks
    done = make("set", scheduler=cluster.scheduler_address)
    assert done.kept == there


def test_workers_stop_when_who_asked_is_killed(recipe, cluster, notes, tmp_path, make):
    text = (
        "import pickle, sys\n"
        "from pepperscene.dataset import build\n"
        "from gated_stand_in import Noting\n"
        "recipe, out, address = pickle.loads(bytes.fromhex(sys.argv[1]))\n"
        f"build(recipe, out, outputs={OUTPUTS!r}, scheduler=address, renderer=Noting)\n"
    )
    asked = pickle.dumps((recipe, tmp_path / "set", cluster.scheduler_address)).hex()
    child = subprocess.Popen([sys.executable, "-c", text, asked], env={**os.environ, "PYTHONPATH": HERE})
    frames = tmp_path / "set" / "frames"
    until(lambda: frames.is_dir() and len(list(frames.glob("*.json"))) >= 2)
    child.kill()
    child.wait()
    until(lambda: not cluster.scheduler.tasks)
    time.sleep(0.3)
    begun = len(rendered(notes))
    time.sleep(0.3)
    assert len(rendered(notes)) == begun
    assert len(open_dataset(tmp_path / "set").indices()) < 24
    done = make("set", scheduler=cluster.scheduler_address)
    assert sorted((*done.made, *done.kept)) == list(range(24))
    make("whole")
    # What a killed process leaves is the marker beside the folder, and that is hidden.
    assert contents(tmp_path / "set") == contents(tmp_path / "whole")


def test_a_frame_told_twice_counts_once(make, cluster, monkeypatch):
    """As when a worker that was thought to be lost goes on."""
    heard = shift.DaskDispatcher._heard

    def twice(self, event):
        heard(self, event)
        heard(self, event)

    monkeypatch.setattr(shift.DaskDispatcher, "_heard", twice)
    told = []
    done = make(scheduler=cluster.scheduler_address, frames="0:6", on_frame=told.append)
    assert [one.index for one in sorted(told, key=lambda one: one.index)] == list(range(6))
    assert done.made == tuple(range(6))


def test_frames_that_nobody_told_of_are_asked_for_again(make, cluster, monkeypatch):
    heard, lost = shift.DaskDispatcher._heard, []

    def deaf(self, event):
        if event[1]["done"] is not None and not lost:
            lost.append(event)
            return
        heard(self, event)

    monkeypatch.setattr(shift.DaskDispatcher, "_heard", deaf)
    done = make(scheduler=cluster.scheduler_address, frames="0:6")
    assert len(done.made) == 5
    assert len(done.kept) == 1


def test_workers_of_another_version_are_refused(make, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(afar, "__version__", "9.9")
    notices = []
    with pytest.raises(WorkerError, match=r"no worker at tcp.* fits: .* has pepperscene .*, not 9\.9"):
        make(scheduler=cluster.scheduler_address, on_notice=notices.append)
    assert len(notices) == 2
    assert not (tmp_path / "set").exists()


def test_workers_that_do_not_see_the_folder_are_refused(make, cluster, tmp_path, monkeypatch):
    @contextmanager
    def elsewhere(folder):
        yield folder / "nowhere" / "marker"

    monkeypatch.setattr(shift, "marker_beside", elsewhere)
    with pytest.raises(WorkerError, match=r"does not see .*; the folder has to be on a shared file system"):
        make(scheduler=cluster.scheduler_address)
    assert not (tmp_path / "set").exists()


def test_workers_that_read_other_files_are_refused(make, cluster, monkeypatch):
    monkeypatch.setattr(afar, "digest", lambda _: "of something else")
    with pytest.raises(WorkerError, match="reads other files by the names in the recipe"):
        make(scheduler=cluster.scheduler_address)


def test_out_of_memory_is_told(make, cluster):
    with pytest.raises(WorkerError, match="out of memory"):
        make(renderer=Hungry, scheduler=cluster.scheduler_address)


def test_a_fault_of_a_worker_is_the_fault_it_found(make, cluster, tmp_path):
    make(frames="0:1")
    (tmp_path / "set" / "class" / "000001.png").mkdir()
    with pytest.raises(OutputError, match=r"000001\.png.*cannot be written"):
        make(frames="0:3", scheduler=cluster.scheduler_address)


def test_a_renderer_that_workers_cannot_import_is_told(make, cluster, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("from stand_in import StandIn\nclass Own(StandIn): pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    import only_here

    with pytest.raises(WorkerError, match=r"cannot begin \(No module named 'only_here'\)"):
        make(renderer=only_here.Own, scheduler=cluster.scheduler_address)


def test_workers_without_the_package_are_left_out_and_live_on(make):
    with local_cluster(1, preload=["import sys; sys.modules['pepperscene'] = None"]) as cluster:
        process = next(iter(cluster.workers.values())).pid
        with pytest.raises(WorkerError, match=r"no worker at tcp.* fits: .* cannot begin \(.*pepperscene"):
            make(scheduler=cluster.scheduler_address)
        assert len(cluster.scheduler.workers) == 1
        assert next(iter(cluster.workers.values())).pid == process


def test_nobody_answers(make, tmp_path, monkeypatch):
    monkeypatch.setattr(crew, "_ANSWER_S", 0.5)
    with pytest.raises(WorkerError, match=r"tcp://127\.0\.0\.1:9: no Dask scheduler answers there"):
        make(scheduler="tcp://127.0.0.1:9")
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize("address", ["", "somewhere", "tcp://host", "tcp://host:x"])
def test_an_address_has_a_host_and_a_port(make, address):
    with pytest.raises(InputError, match="scheduler: must be an address"):
        make(scheduler=address)


def test_a_cluster_without_workers(make, tmp_path, monkeypatch):
    monkeypatch.setattr(crew, "_ALONE_S", 0.5)
    with local_cluster(0) as cluster, pytest.raises(WorkerError, match="has had no worker for"):
        make(scheduler=cluster.scheduler_address)
    assert not (tmp_path / "set").exists()


def test_a_scheduler_that_is_lost(make, tmp_path):
    with local_cluster(1) as cluster:

        def lose(progress):
            if progress.done == 1:
                cluster.close()

        with pytest.raises(WorkerError, match=r"scheduler at .* is lost"):
            make(scheduler=cluster.scheduler_address, on_frame=lose)
    assert open_dataset(tmp_path / "set").indices()

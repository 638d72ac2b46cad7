"""A Dask cluster makes the same files as this process, whatever happens to its workers and to the build."""

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

import pytest
from data_sets import contents
from stand_in import PYTHONPATH, Gated, Hungry, StandIn, rendered, wait_for

from pepperscene.dataset import open_dataset
from pepperscene.dataset.execution import dask_executor, dask_worker
from pepperscene.dataset.recipe.plan import frame_seed
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.errors import InputError, OutputError, WorkerError

distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals end processes here")


@contextmanager
def local_cluster(workers, preload=(), **variables):
    """Worker processes on this machine, with a renderer that takes some time.

    Args:
        workers: number of them.
        preload: Python that each runs first.
        variables: of their environment.
    """
    before = dict(os.environ)
    variables = {name: str(value) for name, value in variables.items()}
    os.environ.update({"PYTHONPATH": PYTHONPATH, "STAND_IN_S": "0.05", **variables})
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
def log(tmp_path_factory):
    return tmp_path_factory.mktemp("log") / "log.txt"


@pytest.fixture(scope="module")
def cluster(log):
    with local_cluster(2, STAND_IN_LOG=log) as cluster:
        yield cluster


@pytest.fixture
def make(build_small, cluster):
    """Builds on the shared cluster, or in this process if `scheduler` is None."""

    def run(out="set", renderer=StandIn, scheduler=cluster.scheduler_address, **arguments):
        return build_small(out, renderer=renderer, scheduler=scheduler, **arguments)

    return run


def test_one_worker_of_four_killed_twice(make, recipe, tmp_path):
    log, gate = tmp_path / "log.txt", tmp_path / "gate"
    complete_at_kill, notices, reported = [], [], []
    seeds = {index: frame_seed(recipe.seed, index) for index in range(24)}

    def kill(nanny):
        """Kill the worker's process once it is at a frame; the nanny starts another one."""
        process = wait_for(lambda: nanny.pid if any(pid == nanny.pid for pid, _ in rendered(log)) else None)
        os.kill(process, signal.SIGKILL)
        wait_for(lambda: nanny.pid != process)
        complete = {seeds[index] for index in open_dataset(tmp_path / "set").indices()}
        complete_at_kill.append((complete, len(rendered(log))))

    def kill_twice(cluster):
        nannies = cluster.workers.values()
        nanny = wait_for(lambda: next((one for one in nannies if one.pid in dict(rendered(log))), None))
        kill(nanny)
        kill(nanny)
        gate.touch()

    with local_cluster(4, STAND_IN_LOG=log, GATE=gate) as cluster:
        killer = threading.Thread(target=kill_twice, args=(cluster,), daemon=True)

        def begin(progress):
            reported.append(progress.index)
            if len(reported) == 1:
                killer.start()

        address = cluster.scheduler_address
        result = make("set", Gated, address, on_frame=begin, on_notice=notices.append)
        killer.join()

    # Complete, and reported once each; what the killed one had finished but not reported was found there.
    assert sorted((*result.made, *result.kept)) == list(range(24))
    assert len(result.kept) <= 2
    assert sorted(reported) == list(range(24))
    # No frame twice in the tables.
    rows = result.dataset.manifest().to_pylist()
    assert [row["index"] for row in rows] == list(range(24))
    lines = (tmp_path / "set" / "journal.jsonl").read_text().splitlines()
    frames = [row["index"] for row in map(json.loads, lines) if "index" in row]
    assert sorted(frames) == list(range(24))
    # Both losses were reported, and what was complete then was not rendered again.
    assert len(notices) == 2
    assert all("a worker was lost over frame 0000" in notice for notice in notices)
    for complete, started in complete_at_kill:
        assert not complete & {seed for _, seed in rendered(log)[started:]}
    # The same as an undisturbed build in one process.
    make("alone", scheduler=None)
    assert contents(tmp_path / "alone") == contents(tmp_path / "set")


def test_a_cluster_makes_the_same_files(make, cluster, tmp_path):
    frames = []
    shared = make("shared", on_frame=frames.append)
    make("alone", scheduler=None)
    assert contents(tmp_path / "alone") == contents(tmp_path / "shared")
    assert sorted(one.index for one in frames) == list(shared.made) == list(range(24))
    assert len({row["worker"] for row in shared.dataset.manifest().to_pylist()}) == 2
    again = make("shared")
    assert (again.made, again.kept) == ((), tuple(range(24)))
    assert not list(tmp_path.rglob(".*"))
    # Workers use as many cores as they have threads.
    with distributed.Client(cluster, set_as_default=False) as client:
        assert set(client.run(lambda: os.environ.get("PEPPERSCENE_THREADS")).values()) == {"1"}


def test_an_interrupt_ends_the_tasks_and_leaves_the_cluster(make, cluster, log, tmp_path):
    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(on_frame=stop)
    started = len(rendered(log))
    dataset = open_dataset(tmp_path / "set")
    indices = dataset.indices()
    # No worker is at a frame any more.
    time.sleep(0.3)
    assert len(rendered(log)) == started
    assert dataset.indices() == indices
    assert 3 <= len(indices) < 24
    assert [row["index"] for row in dataset.manifest().to_pylist()] == list(indices)
    assert len(cluster.scheduler.workers) == 2
    assert not cluster.scheduler.tasks
    assert make().kept == indices


def test_workers_stop_when_the_build_is_killed(recipe, cluster, log, tmp_path, make):
    text = (
        "import pickle, sys\n"
        "from pepperscene.dataset import BuildOptions, build\n"
        "from stand_in import StandIn\n"
        "recipe, out, address = pickle.loads(bytes.fromhex(sys.argv[1]))\n"
        "options = BuildOptions(scheduler=address, renderer=StandIn)\n"
        "build(recipe, out, None, ('class', 'distance'), options)\n"
    )
    arguments = pickle.dumps((recipe, tmp_path / "set", cluster.scheduler_address)).hex()
    child = subprocess.Popen(
        [sys.executable, "-c", text, arguments], env={**os.environ, "PYTHONPATH": PYTHONPATH}
    )
    frames = tmp_path / "set" / "frames"
    wait_for(lambda: frames.is_dir() and len(list(frames.glob("*.json"))) >= 2)
    child.kill()
    child.wait()
    wait_for(lambda: not cluster.scheduler.tasks)

    def is_idle():
        started = len(rendered(log))
        time.sleep(0.3)
        return len(rendered(log)) == started

    wait_for(is_idle, 5.0)
    assert len(open_dataset(tmp_path / "set").indices()) < 24
    result = make()
    assert sorted((*result.made, *result.kept)) == list(range(24))
    make("whole", scheduler=None)
    # What a killed process leaves is the marker beside the folder, and that is hidden.
    assert contents(tmp_path / "set") == contents(tmp_path / "whole")


def test_a_frame_reported_twice_counts_once(make, monkeypatch):
    """As when a worker that was taken for lost goes on."""
    receive = dask_executor._DaskBuild._receive

    def twice(self, event):
        receive(self, event)
        receive(self, event)

    monkeypatch.setattr(dask_executor._DaskBuild, "_receive", twice)
    frames = []
    result = make(frames="0:6", on_frame=frames.append)
    assert sorted(one.index for one in frames) == list(range(6))
    assert result.made == tuple(range(6))


def test_frames_that_were_not_reported_are_requested_again(make, monkeypatch):
    receive, lost = dask_executor._DaskBuild._receive, []

    def lossy(self, event):
        if event[1]["done"] is not None and not lost:
            lost.append(event)
            return
        receive(self, event)

    monkeypatch.setattr(dask_executor._DaskBuild, "_receive", lossy)
    result = make(frames="0:6")
    assert (len(result.made), len(result.kept)) == (5, 1)


# --- workers that cannot be used, and errors ----------------------------------------------------------------


def test_workers_of_another_version_are_refused(make, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_worker, "__version__", "9.9")
    notices = []
    with pytest.raises(WorkerError, match=r"no worker at tcp.* can be used: .* has pepperscene .*, not 9\.9"):
        make(on_notice=notices.append)
    assert len(notices) == 2
    assert all("it is not used" in notice for notice in notices)
    assert not (tmp_path / "set").exists()


def test_workers_that_do_not_see_the_folder_are_refused(make, tmp_path, monkeypatch):
    real = dask_worker.BuildRequest.create
    monkeypatch.setattr(
        dask_worker.BuildRequest, "create", lambda build, marker, job: real(build, tmp_path / "gone", job)
    )
    with pytest.raises(WorkerError, match=r"no worker at tcp.* can be used: .* does not see"):
        make()
    assert not (tmp_path / "set").exists()


def test_workers_that_read_other_files_are_refused(make, monkeypatch):
    real = Recipe.identity
    monkeypatch.setattr(Recipe, "identity", lambda self: real(self) | {"files": {}})
    with pytest.raises(WorkerError, match="reads other files by the names in the recipe"):
        make()


def test_workers_without_the_package_are_not_used_and_live_on(make):
    with local_cluster(1, preload=["import sys; sys.modules['pepperscene'] = None"]) as cluster:
        process = next(iter(cluster.workers.values())).pid
        with pytest.raises(WorkerError, match=r"can be used: .* cannot start \(.*pepperscene"):
            make(scheduler=cluster.scheduler_address)
        assert len(cluster.scheduler.workers) == 1
        assert next(iter(cluster.workers.values())).pid == process


def test_a_renderer_that_workers_cannot_import_is_reported(make, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("from stand_in import StandIn\nclass Own(StandIn): pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    import only_here

    with pytest.raises(WorkerError, match=r"cannot start \(No module named 'only_here'\)"):
        make(renderer=only_here.Own)


def test_out_of_memory_is_reported(make):
    with pytest.raises(WorkerError, match="out of memory"):
        make(renderer=Hungry)


def test_an_error_of_a_worker_is_raised_here(make, tmp_path):
    make(frames="0:1", scheduler=None)
    (tmp_path / "set" / "class" / "000001.png").mkdir()
    with pytest.raises(OutputError, match=r"000001\.png.*cannot be written"):
        make(frames="0:3")


def test_a_scheduler_that_does_not_answer(make, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_executor, "_ANSWER_S", 0.5)
    with pytest.raises(WorkerError, match=r"tcp://127\.0\.0\.1:9: no Dask scheduler answers there"):
        make(scheduler="tcp://127.0.0.1:9")
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize("address", ["", "somewhere", "tcp://host", "tcp://host:x"])
def test_an_address_has_a_host_and_a_port(make, address):
    with pytest.raises(InputError, match="scheduler: must be an address"):
        make(scheduler=address)


def test_a_cluster_without_workers(make, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_executor, "_NO_WORKER_S", 0.5)
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

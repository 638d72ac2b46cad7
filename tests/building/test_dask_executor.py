"""A Dask cluster makes the same files as this process, also if workers or the build are killed."""

from __future__ import annotations

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
from stand_in import PYTHONPATH, GatedRenderer, rendered, wait_for

from pepperscene.building.execution import dask_executor, dask_worker
from pepperscene.building.execution.dask_executor import trusts_network
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError, OutputError, WorkerError
from pepperscene.recipe.plan import frame_seed
from pepperscene.recipe.recipe import Recipe

distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals")


@contextmanager
def local_cluster(workers, preload=(), **variables):
    """Worker processes on this machine, which first run the Python texts in `preload`.

    Further arguments are environment variables. Their stand-in renderer takes some time.
    """
    with pytest.MonkeyPatch.context() as monkeypatch:
        for name, value in {"PYTHONPATH": PYTHONPATH, "STAND_IN_S": "0.05", **variables}.items():
            monkeypatch.setenv(name, str(value))
        with distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",
            silence_logs=50,
            preload=list(preload),
        ) as cluster:
            yield cluster


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

    def run(out="set", scheduler=cluster.scheduler_address, **arguments):
        return build_small(out, scheduler=scheduler, **arguments)

    return run


@pytest.fixture
def assert_complete(make, tmp_path):
    """Compares a data set with an undisturbed build in one process."""

    def check(out):
        make("serial", scheduler=None)
        assert contents(tmp_path / out) == contents(tmp_path / "serial")

    return check


@pytest.mark.long
def test_worker_that_is_killed(make, recipe, assert_complete, tmp_path):
    log, gate = tmp_path / "log.txt", tmp_path / "gate"
    at_kill, notices, reported = [], [], []
    seeds = {index: frame_seed(recipe.seed, index) for index in range(24)}

    def kill_one(cluster):
        """Kill the process of a worker that has rendered a frame; its nanny starts another one."""
        try:
            nannies = cluster.workers.values()
            running = wait_for(lambda: {one.pid for one in nannies} & dict(rendered(log)).keys())
            os.kill(min(running), signal.SIGKILL)
            wait_for(lambda: min(running) not in {one.pid for one in nannies})
            complete = {seeds[index] for index in open_dataset(tmp_path / "set").indices()}
            at_kill.append((complete, len(rendered(log))))
        finally:
            gate.touch()

    with local_cluster(2, STAND_IN_LOG=log, GATE=gate) as cluster:
        killer = threading.Thread(target=kill_one, args=(cluster,), daemon=True)

        def on_frame(progress):
            reported.append(progress.index)
            if len(reported) == 1:
                killer.start()

        address = cluster.scheduler_address
        result = make("set", address, renderer=GatedRenderer, on_frame=on_frame, on_notice=notices.append)
        killer.join()

    # All frames are complete and reported once; those that the killed worker had not reported were found.
    assert sorted((*result.made, *result.kept)) == list(range(24))
    assert len(result.kept) <= 1
    assert sorted(reported) == list(range(24))
    assert result.dataset.manifest()["index"].to_pylist() == list(range(24))
    # The loss was reported, and complete frames were not rendered again.
    (notice,) = notices
    assert "a worker was lost over frame 0000" in notice
    ((complete, started),) = at_kill
    assert not complete & {seed for _, seed in rendered(log)[started:]}
    assert_complete("set")


def test_cluster_makes_the_same_files(make, cluster, assert_complete, tmp_path):
    reports = []
    result = make(on_frame=reports.append)
    assert_complete("set")
    assert sorted(report.index for report in reports) == list(result.made) == list(range(24))
    assert len({row["worker"] for row in result.dataset.manifest().to_pylist()}) == 2
    result = make()
    assert (result.made, result.kept) == ((), tuple(range(24)))
    assert not list(tmp_path.rglob(".*"))
    # Workers use as many cores as they have threads.
    with distributed.Client(cluster, set_as_default=False) as client:
        assert set(client.run(lambda: os.environ.get("PEPPERSCENE_THREADS")).values()) == {"1"}


def test_interrupt_ends_the_tasks_and_keeps_the_cluster(make, cluster, log, tmp_path):
    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(on_frame=stop)
    started = len(rendered(log))
    dataset = open_dataset(tmp_path / "set")
    indices = dataset.indices()
    # No worker renders any more.
    time.sleep(0.3)
    assert len(rendered(log)) == started
    assert dataset.indices() == indices
    assert 3 <= len(indices) < 24
    assert dataset.manifest()["index"].to_pylist() == list(indices)
    assert len(cluster.scheduler.workers) == 2
    assert not cluster.scheduler.tasks
    assert make().kept == indices


@pytest.mark.long
def test_workers_stop_when_the_build_is_killed(recipe, cluster, log, tmp_path, make, assert_complete):
    script = (
        "import pickle, sys\n"
        "from pepperscene import BuildOptions, build\n"
        "from stand_in import StandIn\n"
        "recipe, out, address = pickle.loads(bytes.fromhex(sys.argv[1]))\n"
        "options = BuildOptions(scheduler=address, renderer=StandIn)\n"
        "build(recipe, out, None, ('class', 'distance'), options)\n"
    )
    arguments = pickle.dumps((recipe, tmp_path / "set", cluster.scheduler_address)).hex()
    process = subprocess.Popen(
        [sys.executable, "-c", script, arguments], env={**os.environ, "PYTHONPATH": PYTHONPATH}
    )
    frames = tmp_path / "set" / "frames"
    wait_for(lambda: frames.is_dir() and len(list(frames.glob("*.json"))) >= 2)
    process.kill()
    process.wait()
    wait_for(lambda: not cluster.scheduler.tasks)

    def is_idle():
        started = len(rendered(log))
        time.sleep(0.3)
        return len(rendered(log)) == started

    wait_for(is_idle)
    assert len(open_dataset(tmp_path / "set").indices()) < 24
    result = make()
    assert sorted((*result.made, *result.kept)) == list(range(24))
    assert_complete("set")


def test_a_frame_can_be_reported_twice_or_never(make, monkeypatch):
    """As if a worker that was taken for lost goes on, and as if a message was lost."""
    receive, lost, reports = dask_executor._DaskBuild._receive, [], []

    def lose_first_and_repeat(self, event):
        if event[1]["done"] is not None and not lost:
            lost.append(event)
        else:
            receive(self, event)
            receive(self, event)

    monkeypatch.setattr(dask_executor._DaskBuild, "_receive", lose_first_and_repeat)
    result = make(frames="0:6", on_frame=reports.append)
    assert (len(result.made), len(result.kept)) == (5, 1)
    assert sorted(report.index for report in reports) == list(range(6))


def test_workers_of_another_version_are_not_used(make, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_worker, "__version__", "9.9")
    notices = []
    with pytest.raises(WorkerError, match=r"no worker at tcp.* can be used: .* has pepperscene .*, not 9\.9"):
        make(on_notice=notices.append)
    assert len(notices) == 2
    assert all("it is not used" in notice for notice in notices)
    assert not (tmp_path / "set").exists()


def test_workers_that_do_not_see_the_folder_are_not_used(make, tmp_path, monkeypatch):
    request = dask_worker.BuildRequest
    create = request.create
    monkeypatch.setattr(request, "create", lambda build, marker, job: create(build, tmp_path / "gone", job))
    with pytest.raises(WorkerError, match=r"no worker at tcp.* can be used: .* does not see"):
        make()
    assert not (tmp_path / "set").exists()


def test_workers_that_read_other_files_are_not_used(make, monkeypatch):
    identity = Recipe.identity
    monkeypatch.setattr(Recipe, "identity", lambda self: identity(self) | {"files": {}})
    with pytest.raises(WorkerError, match="reads other files by the names in the recipe"):
        make()


@pytest.mark.long
def test_workers_without_the_package_are_not_used_and_do_not_end(make):
    with local_cluster(1, preload=["import sys; sys.modules['pepperscene'] = None"]) as cluster:
        process = next(iter(cluster.workers.values())).pid
        with pytest.raises(WorkerError, match=r"can be used: .* cannot start \(.*pepperscene"):
            make(scheduler=cluster.scheduler_address)
        assert len(cluster.scheduler.workers) == 1
        assert next(iter(cluster.workers.values())).pid == process


def test_renderer_that_workers_cannot_import_is_reported(make, local_renderer):
    with pytest.raises(WorkerError, match=r"cannot start \(No module named 'only_here'\)"):
        make(renderer=local_renderer)


@pytest.mark.slow
def test_workers_with_too_little_memory_are_not_used(make, cluster, tmp_path):
    def allow(size):
        with distributed.Client(cluster, set_as_default=False) as client:
            client.run(lambda: os.environ.update(PEPPERSCENE_MEMORY=size))

    allow("400 MB")
    try:
        with pytest.raises(WorkerError, match=r"can be used: .* needs about .* 0\.4 GB are allowed by"):
            make(renderer=None, outputs=("colour",))
    finally:
        allow("off")
    assert len(cluster.scheduler.workers) == 2
    assert not (tmp_path / "set").exists()


def test_error_of_a_worker_is_raised_here(make, tmp_path):
    make(frames="0:1", scheduler=None)
    (tmp_path / "set" / "class" / "000001.png").mkdir()
    with pytest.raises(OutputError, match=r"000001\.png.*cannot be written"):
        make(frames="0:3")


def test_scheduler_that_does_not_answer(make, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_executor, "_ANSWER_S", 0.5)
    with pytest.raises(WorkerError, match=r"tcp://127\.0\.0\.1:9: no Dask scheduler answers there"):
        make(scheduler="tcp://127.0.0.1:9")
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("address", "is_warned"),
    [
        ("tcp://192.0.2.7:8786", True),
        ("ws://somewhere.invalid:8786", True),
        ("tls://192.0.2.7:8786", False),
        ("tcp://127.0.0.1:8786", False),
        ("tcp://localhost:8786", False),
    ],
)
def test_addresses_that_trust_their_network(address, is_warned):
    assert trusts_network(address) == is_warned


def test_rejects_address_without_host_and_port(make):
    for address in ("", "somewhere", "tcp://host", "tcp://host:x"):
        with pytest.raises(InputError, match="scheduler: must be an address"):
            make(scheduler=address)


@pytest.mark.long
def test_cluster_without_workers(make, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_executor, "_NO_WORKER_S", 0.5)
    with local_cluster(0) as cluster, pytest.raises(WorkerError, match="has had no worker for"):
        make(scheduler=cluster.scheduler_address)
    assert not (tmp_path / "set").exists()


@pytest.mark.long
def test_scheduler_that_is_lost(make, tmp_path):
    with local_cluster(1) as cluster:

        def close_cluster(progress):
            if progress.done == 1:
                cluster.close()

        with pytest.raises(WorkerError, match=r"scheduler at .* is lost"):
            make(scheduler=cluster.scheduler_address, on_frame=close_cluster)
    assert open_dataset(tmp_path / "set").indices()

"""Builds in Slurm jobs answer only their own processes, and hostile values of a jobs file run nothing."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import stat
import subprocess
import sys
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import fake_slurm
import pytest
import tomli_w
from stand_in import process_fields

from pepperscene.building.execution import slurm
from pepperscene.building.execution.credentials import temporary_credentials
from pepperscene.errors import InputError, SetupError, WorkerError

distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")
pytest.importorskip("dask_jobqueue", reason="needs the extra `cluster`")
x509 = pytest.importorskip("cryptography.x509", reason="needs the extra `cluster`")
psutil = pytest.importorskip("psutil", reason="needs the extra `cluster`")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs Linux")

IS_ROOT = hasattr(os, "getuid") and os.getuid() == 0
JOBS = {"jobs": 1, "cores": 1, "memory": "1 GB", "walltime": "10:00"}

INJECTION = "a b;touch injected;$(touch injected)`touch injected`&|<>*~#$HOME%j"
"""A name that runs commands where a shell sees it without quotation marks."""

RECORDING_PYTHON = """#!{python} -I
import json, os, sys
from pathlib import Path
options = dict(zip(sys.argv[1:], sys.argv[2:]))
options |= dict(word.split("=", 1) for word in sys.argv if word.startswith("--") and "=" in word)
options["local mode"] = os.stat(options["--local-directory"]).st_mode & 0o777
options["key mode"] = os.stat(options["--tls-key"]).st_mode & 0o777
options["key folder mode"] = os.stat(os.path.dirname(options["--tls-key"])).st_mode & 0o777
options["python"] = sys.argv[0]
Path({record!r}).write_text(json.dumps(options))
"""

ATTACK = r"""
import json, os, socket, ssl, sys
addresses, paths, certificate, key = json.loads(sys.argv[1])

def contexts():
    yield None
    for with_certificate in (False, True):
        for version in (ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3):
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            context.maximum_version = version
            if with_certificate:
                context.load_cert_chain(certificate, key)
            yield context

def answer(address, request, context):
    try:
        with socket.create_connection(address, 2) as connection:
            connection.settimeout(0.5)
            if context is not None:
                connection = context.wrap_socket(connection)
            connection.sendall(request)
            received = connection.recv(1000)
            # An alert, by which TLS refuses what is not encrypted.
            return b"" if context is None and received[:1] == b"\x15" else received
    except OSError:
        return b""

def tries(path):
    yield lambda: open(path).read()
    yield lambda: os.listdir(path)
    yield lambda: os.rename(path, path + "-old")
    yield lambda: open(path, "a").write("x")
    yield lambda: os.symlink("/", path + "/link")

results = []
for address in addresses:
    for context in contexts():
        # Servers of Dask send the first message.
        for request in (b"", b"GET / HTTP/1.0\r\n\r\n"):
            if answer(tuple(address), request, context):
                results.append(f"{address} answers")
for path in paths:
    for attempt in tries(path):
        try:
            attempt()
        except OSError:
            continue
        results.append(f"{path} is open")
print(json.dumps([os.getuid(), results]))
"""


@pytest.fixture
def folder(monkeypatch):
    """A folder that other users can see, in contrast to those of pytest, as the current folder."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name).resolve()
        path.chmod(0o755)
        (path / "current").mkdir()
        monkeypatch.chdir(path / "current")
        yield path


@pytest.fixture
def commands(folder, monkeypatch):
    return fake_slurm.install(folder, monkeypatch)


@pytest.fixture
def foreign(folder):
    """Certificate and key of another cluster, readable by everybody."""
    security = distributed.Security.temporary()
    files = folder / "certificate.pem", folder / "key.pem"
    for path, text in zip(files, (security.tls_worker_cert, security.tls_worker_key), strict=True):
        path.write_text(text)
    return files


def write_jobs(folder, **keys):
    path = folder / "jobs.toml"
    path.write_text(tomli_w.dumps(JOBS | keys), encoding="utf-8")
    return path


def attack(addresses, paths, foreign, user):
    """What another process gets from addresses and paths, as the user of this process if `user` is None."""
    arguments = json.dumps([sorted(addresses), [str(path) for path in paths], *map(str, foreign)])
    switch = {} if user is None else {"user": user, "group": "nogroup", "extra_groups": []}
    # The Python of this process may be in a folder of root.
    for python in (sys.executable, shutil.which("python3", path="/usr/local/bin:/usr/bin")):
        try:
            command = [python, "-I", "-c", ATTACK, arguments]
            result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd="/", **switch)
        except (PermissionError, TypeError):
            continue
        assert not result.stderr
        actual_user, results = json.loads(result.stdout)
        assert actual_user == os.getuid() or user is not None
        return results
    pytest.skip("the other user has no Python")


def listening(processes):
    """Addresses and ports on which processes listen."""
    return {
        (entry.laddr.ip, entry.laddr.port)
        for entry in psutil.net_connections(kind="tcp")
        if entry.status == psutil.CONN_LISTEN and entry.pid in processes
    }


def build_and_attack(build_small, commands, folder, jobs, try_it):
    """Build, and call a function with the new listening addresses at the first frame; returns its result."""
    before = listening({os.getpid()})
    results = []

    def on_frame(progress):
        if not results:
            session = int((commands / "1" / "session").read_text())
            workers = {number for number, *_, one in process_fields() if one == session}
            results.append(try_it(listening({os.getpid(), *workers}) - before, workers))

    result = build_small(folder / "set", slurm=jobs, frames="0:3", on_frame=on_frame)
    assert len(result.made) == 3
    return results[0]


@pytest.mark.slow
def test_build_answers_no_client_without_its_key(build_small, commands, folder, foreign):
    def try_it(addresses, workers):
        assert attack(addresses, (), foreign, None) == []
        for host, port in addresses:
            with pytest.raises(OSError, match=r"Timed out|TLS|SSL|expected|closed|lost"):
                distributed.Client(f"tcp://{host}:{port}", timeout=1, set_as_default=False)
            with pytest.raises(OSError, match=r"certificate verify failed|TLS|SSL"):
                distributed.Client(
                    f"tls://{host}:{port}",
                    timeout=1,
                    set_as_default=False,
                    security=distributed.Security(
                        tls_ca_file=str(foreign[0]),
                        tls_client_cert=str(foreign[0]),
                        tls_client_key=str(foreign[1]),
                        require_encryption=True,
                    ),
                )
        return addresses

    # Without an interface in the file, there is one address too.
    addresses = build_and_attack(build_small, commands, folder, write_jobs(folder), try_it)
    # The scheduler, a nanny and its worker: none of them has a second port.
    assert len(addresses) == 3
    assert len({host for host, _ in addresses}) == 1
    assert not {"0.0.0.0", "::"} & {host for host, _ in addresses}
    # Nothing remains.
    assert not [path for path in folder.rglob("*") if ".credentials" in path.name]


@pytest.mark.slow
@pytest.mark.skipif(not IS_ROOT, reason="needs a second user")
def test_another_user_gets_and_replaces_nothing(build_small, commands, folder, foreign, monkeypatch):
    # Everybody may make folders here, as in /tmp, and the other user has made the one that Dask would use.
    shared = folder / "shared"
    (shared / "dask-scratch-space").mkdir(parents=True)
    shared.chmod(0o1777)
    (shared / "dask-scratch-space").chmod(0o777)
    os.chown(shared / "dask-scratch-space", 65534, 65534)
    monkeypatch.setenv("TMPDIR", str(shared))
    monkeypatch.setattr(tempfile, "tempdir", str(shared))

    def try_it(addresses, workers):
        lines = [Path(f"/proc/{number}/cmdline").read_text() for number in workers]
        assert not any("PRIVATE KEY" in line for line in lines)
        (key_folder,) = folder.glob(".credentials.*.tmp")
        private = [*shared.glob("pepperscene-*"), key_folder]
        # One of the scheduler, one of the job, and the key.
        assert len(private) == 3
        assert all(stat.S_IMODE(path.stat().st_mode) == 0o700 for path in private)
        paths = [inside for path in private for inside in (path, *path.rglob("*"))]
        assert not list((shared / "dask-scratch-space").iterdir())
        return attack(addresses, paths, foreign, "nobody")

    # Modules beside the user, which another user may have written, are not imported.
    for name in ("distributed", "click", "tornado"):
        (folder / "current" / f"{name}.py").write_text("raise SystemExit('was imported')")
    jobs = write_jobs(folder, interface="lo")
    assert build_and_attack(build_small, commands, folder, jobs, try_it) == []


@pytest.mark.slow
def test_attack_finds_what_is_open(folder, foreign):
    """The attempts above are real: an unprotected cluster and an open file answer them."""
    (folder / "open").write_text("x")
    with distributed.LocalCluster(
        n_workers=0, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster:
        addresses = [
            ["127.0.0.1", server.port] for server in (cluster.scheduler, cluster.scheduler.http_server)
        ]
        results = attack(addresses, [folder / "open"], foreign, None)
    for address in addresses:
        assert f"{address} answers" in results
    assert f"{folder / 'open'} is open" in results


@pytest.mark.slow
def test_hostile_values_arrive_whole_and_run_nothing(build_small, commands, folder, monkeypatch):
    monkeypatch.setattr(slurm, "_QUEUE_CHECK_S", 0.1)
    monkeypatch.setattr(slurm, "_QUEUE_CHECKS", 2)
    hostile = folder / INJECTION
    quotes = hostile / 'it\'s "quoted" \\'
    quotes.mkdir(parents=True)
    record = folder / "record.json"
    python = quotes / "python; touch injected"
    python.write_text(RECORDING_PYTHON.format(python=sys.executable, record=str(record)))
    python.chmod(0o755)
    jobs = write_jobs(
        folder,
        python=str(python),
        local_directory=str(quotes / "-local"),
        log_directory=str(hostile / "logs"),
        credentials_directory=str(quotes),
        interface="lo",
    )
    # The job ends at once, because its Python is not one.
    with pytest.raises(WorkerError, match="Slurm has none of the jobs any more"):
        build_small(hostile / "set", slurm=jobs)

    options = json.loads(record.read_text())
    assert options["python"] == str(python)
    assert Path(options["--local-directory"]).parent == quotes / "-local"
    for option in ("--tls-key", "--tls-cert", "--tls-ca-file"):
        assert Path(options[option]).parent.parent == quotes
    assert (options["key mode"], options["key folder mode"], options["local mode"]) == (0o600, 0o700, 0o700)
    assert options["--interface"] == "lo"
    assert options["--worker-class"].endswith("WithoutHttp")
    assert "--no-dashboard" in (commands / "1" / "job.sh").read_text()
    # `sbatch` splits its lines as a shell does, and replaces single percent signs.
    lines = [
        shlex.split(line) for line in (commands / "1" / "job.sh").read_text().splitlines() if " -o " in line
    ]
    assert lines == [["#SBATCH", "-o", f"{hostile}/logs/pepperscene-".replace("%", "%%") + "%J.out"]]
    assert (hostile / "logs").is_dir()
    # Nothing was run, and nothing remains of the build.
    assert not list((folder / "current").iterdir())
    assert not [path for path in folder.rglob("*") if path.name == "injected"]
    assert not list(quotes.glob(".*"))
    assert not list((quotes / "-local").iterdir())


def test_key_is_not_kept_where_other_users_may_replace_it(tmp_path):
    exposed, private = tmp_path / "exposed", tmp_path / "private"
    exposed.mkdir()
    (exposed / "below").mkdir()
    private.mkdir(mode=0o700)
    exposed.chmod(0o777)
    with temporary_credentials([exposed / "below", tmp_path / "missing", private]) as credentials:
        key = Path(credentials.tls_worker_key)
        assert key.parent.parent == private
        # Clocks of nodes may be behind that of this machine.
        certificate = x509.load_pem_x509_certificate(Path(credentials.tls_worker_cert).read_bytes())
        assert certificate.not_valid_before_utc < datetime.now(UTC) - timedelta(minutes=5)
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
        assert stat.S_IMODE(key.parent.stat().st_mode) == 0o700
    assert not list(private.iterdir())
    with (
        pytest.raises(SetupError, match="no safe folder for the key of this build: other users may write to"),
        temporary_credentials([exposed / "below"]),
    ):
        pytest.fail("the folder was used")
    assert not list((exposed / "below").iterdir())


def test_folder_for_the_key_that_is_not_safe_is_reported(build_small, commands, folder):
    exposed = folder / "exposed"
    exposed.mkdir()
    exposed.chmod(0o777)
    with pytest.raises(SetupError, match=r"exposed; name one in credentials_directory"):
        build_small(folder / "set", slurm=write_jobs(folder, credentials_directory=str(exposed)))
    assert not (folder / "set").exists()


def test_encrypted_scheduler_without_credentials_is_reported(build_small, tmp_path):
    with pytest.raises(InputError) as caught:
        build_small(scheduler="tls://127.0.0.1:8786")
    for word in ("tls://127.0.0.1:8786 needs credentials", "ca-file", "client.cert", "client.key"):
        assert word in str(caught.value)
    assert not (tmp_path / "set").exists()


def test_encrypted_scheduler_with_missing_files_is_reported(build_small, tmp_path):
    tls = {name: str(tmp_path / "missing.pem") for name in ("ca-file", "client.cert", "client.key")}
    dask = pytest.importorskip("dask")
    with (
        dask.config.set({f"distributed.comm.tls.{name}": path for name, path in tls.items()}),
        pytest.raises(InputError, match=r"those in Dask's configuration .* cannot be used: .*No such file"),
    ):
        build_small(scheduler="tls://127.0.0.1:8786")


@pytest.mark.slow
def test_encrypted_scheduler_with_configured_credentials(build_small, tmp_path, monkeypatch):
    dask = pytest.importorskip("dask")
    monkeypatch.setenv("PYTHONPATH", fake_slurm.PYTHONPATH)
    with (
        temporary_credentials([tmp_path]) as credentials,
        distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            dashboard_address=":0",
            silence_logs=50,
            security=credentials,
            protocol="tls://",
        ) as cluster,
        dask.config.set(
            {
                "distributed.comm.tls.ca-file": credentials.tls_ca_file,
                "distributed.comm.tls.client.cert": credentials.tls_client_cert,
                "distributed.comm.tls.client.key": credentials.tls_client_key,
            }
        ),
    ):
        notices = []
        result = build_small(scheduler=cluster.scheduler_address, frames="0:2", on_notice=notices.append)
    assert cluster.scheduler_address.startswith("tls://")
    assert len(result.made) == 2
    assert notices == []

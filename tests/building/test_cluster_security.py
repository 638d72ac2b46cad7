"""Builds in Slurm jobs answer only their own processes; encrypted schedulers need credentials."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import fake_slurm
import pytest
from stand_in import process_fields

from pepperscene.errors import InputError

dask = pytest.importorskip("dask", reason="needs the extra `cluster`")
distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")
pytest.importorskip("dask_jobqueue", reason="needs the extra `cluster`")
pytest.importorskip("cryptography", reason="needs the extra `cluster`")
psutil = pytest.importorskip("psutil")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs Linux")

IS_ROOT = hasattr(os, "getuid") and os.getuid() == 0

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
            # An alert, by which TLS refuses what is not encrypted, or a server without pages.
            refusals = (b"\x15", b"HTTP/1.1 404")
            return b"" if context is None and received.startswith(refusals) else received
    except OSError:
        return b""

def tries(path):
    yield lambda: open(path).read()
    yield lambda: os.listdir(path)
    yield lambda: os.rename(path, path + "-old")
    yield lambda: open(path, "a").write("x")

results = []
for address in addresses:
    for context in contexts():
        # Servers of Dask send the first message.
        for page in (b"", b"/", b"/health", b"/json/counts.json", b"/info/main/workers.html"):
            request = b"" if page == b"" else b"GET " + page + b" HTTP/1.0\r\n\r\n"
            if answer(tuple(address), request, context):
                results.append(f"{address} answers {page}")
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
    """A folder that other users can see, in contrast to those of pytest, with the home and current folder."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name).resolve()
        path.chmod(0o755)
        (path / "current").mkdir()
        (path / "home").mkdir(mode=0o755)
        monkeypatch.setenv("HOME", str(path / "home"))
        monkeypatch.chdir(path / "current")
        yield path


@pytest.fixture
def foreign(folder):
    """Certificate and key of another cluster, readable by everybody."""
    security = distributed.Security.temporary()
    files = folder / "certificate.pem", folder / "key.pem"
    for path, text in zip(files, (security.tls_worker_cert, security.tls_worker_key), strict=True):
        path.write_text(text)
    return files


def attack(addresses, paths, foreign, user=None):
    """What another process gets from addresses and paths, as the user of this process if `user` is None."""
    arguments = json.dumps([sorted(addresses), [str(path) for path in paths], *map(str, foreign)])
    switch = {} if user is None else {"user": user, "group": "nogroup", "extra_groups": []}
    # The Python of this process may be in a folder of root.
    for python in (sys.executable, shutil.which("python3", path="/usr/local/bin:/usr/bin")):
        try:
            command = [python, "-I", "-c", ATTACK, arguments]
            result = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd="/", **switch)
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


@pytest.mark.long
@pytest.mark.parametrize(
    "user", [None, pytest.param("nobody", marks=pytest.mark.skipif(not IS_ROOT, reason=""))]
)
def test_build_answers_nobody_without_its_key(user, build_small, folder, foreign, monkeypatch):
    if user is not None and not IS_ROOT:
        pytest.skip("needs a second user")
    commands = fake_slurm.install(folder, monkeypatch)
    # Everybody may make folders here, as in /tmp, and the other user has made the one that Dask would use.
    shared = folder / "shared"
    (shared / "dask-scratch-space").mkdir(parents=True)
    shared.chmod(0o1777)
    (shared / "dask-scratch-space").chmod(0o777)
    monkeypatch.setenv("TMPDIR", str(shared))
    monkeypatch.setattr(tempfile, "tempdir", str(shared))
    # Modules beside the user, which another user may have written, are not imported.
    for name in ("distributed", "click", "tornado"):
        (folder / "current" / f"{name}.py").write_text("raise SystemExit('was imported')")
    before, results = listening({os.getpid()}), []

    def on_frame(_):
        if results:
            return
        session = int((commands / "1" / "session").read_text())
        workers = {number for number, *_, one in process_fields() if one == session}
        assert not any("PRIVATE KEY" in Path(f"/proc/{number}/cmdline").read_text() for number in workers)
        private = [*shared.glob("pepperscene-*"), *(folder / "home").iterdir()]
        assert len(private) == 3  # of the scheduler, of the job, and the key
        paths = [] if user is None else [inside for one in private for inside in (one, *one.rglob("*"))]
        assert not list((shared / "dask-scratch-space").iterdir())
        addresses = listening({os.getpid(), *workers}) - before
        assert len(addresses) >= 3
        results.append(attack(addresses, paths, foreign, user))

    path = folder / "jobs.toml"
    path.write_text('jobs = 1\ncores = 1\nmemory = "1 GB"\nwalltime = "10:00"\n')
    assert len(build_small(folder / "set", slurm=path, frames="0:3", on_frame=on_frame).made) == 3
    assert results == [[]]
    assert not list((folder / "home").iterdir())


@pytest.mark.long
def test_attack_finds_what_is_open(folder, foreign):
    """The attempts above are real: an unprotected cluster and an open file answer them."""
    (folder / "open").write_text("x")
    with distributed.LocalCluster(
        n_workers=0, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster:
        addresses = [
            ["127.0.0.1", server.port] for server in (cluster.scheduler, cluster.scheduler.http_server)
        ]
        results = attack(addresses, [folder / "open"], foreign)
    for address in addresses:
        assert any(result.startswith(f"{address} answers") for result in results)
    assert f"{folder / 'open'} is open" in results


def test_encrypted_scheduler_without_credentials_is_reported(build_small, tmp_path):
    with pytest.raises(InputError) as caught:
        build_small(scheduler="tls://127.0.0.1:8786")
    for word in ("tls://127.0.0.1:8786 needs credentials", "ca-file", "client.cert", "client.key"):
        assert word in str(caught.value)
    tls = {name: str(tmp_path / "missing.pem") for name in ("ca-file", "client.cert", "client.key")}
    with (
        dask.config.set({f"distributed.comm.tls.{name}": path for name, path in tls.items()}),
        pytest.raises(InputError, match=r"those in Dask's configuration .* cannot be used: .*No such file"),
    ):
        build_small(scheduler="tls://127.0.0.1:8786")
    assert not (tmp_path / "set").exists()


@pytest.mark.slow
def test_encrypted_scheduler_with_configured_credentials(build_small, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", fake_slurm.PYTHONPATH)
    credentials = distributed.Security.temporary()
    files = {"ca-file": credentials.tls_ca_file, "client.cert": credentials.tls_client_cert}
    files["client.key"] = credentials.tls_client_key
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    configured = {f"distributed.comm.tls.{name}": str(tmp_path / name) for name in files}
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": 50}
    with (
        distributed.LocalCluster(security=credentials, protocol="tls://", **options) as cluster,
        dask.config.set(configured),
    ):
        notices = []
        result = build_small(scheduler=cluster.scheduler_address, frames="0:2", on_notice=notices.append)
        # Nobody connects without the key.
        others = distributed.Security.temporary()
        with pytest.raises(OSError, match=r"certificate verify failed|TLS|SSL"):
            distributed.Client(cluster.scheduler_address, timeout=1, set_as_default=False, security=others)
    assert cluster.scheduler_address.startswith("tls://")
    assert (len(result.made), notices) == (2, [])

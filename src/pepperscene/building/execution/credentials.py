"""Certificates and keys, by which the processes of a Dask cluster recognise each other."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pepperscene.atomic import temporary_path
from pepperscene.errors import ArgumentError, SetupError

if TYPE_CHECKING:
    from distributed.security import Security


_ENCRYPTED: Final = ("tls", "wss")
"""Schemes of addresses whose connections need credentials."""

_CLOCK_DIFFERENCE: Final = timedelta(hours=1)
"""Chosen: Slurm itself refuses nodes whose clocks differ by more than five minutes."""

_VALIDITY: Final = timedelta(days=365)  # chosen: longer than any build

_OTHERS_MAY_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH


@contextmanager
def temporary_credentials(parents: Sequence[Path]) -> Iterator[Security]:
    """A certificate and its key for one cluster, in a new folder that only this user can read.

    The key is needed to use any process of the cluster, and gives access to all of them. The folder is
    removed at the end.

    Args:
        parents: folders that all machines of the cluster see; the first suitable one is used.

    Raises:
        SetupError: no folder can be written to and is safe from other users.
    """
    from distributed.security import Security

    # All processes have the same certificate, which is its own authority.
    folder = _write_private(_make_certificate(), parents)
    certificate, key = str(folder / "certificate.pem"), str(folder / "key.pem")
    try:
        yield Security(
            require_encryption=True,
            tls_ca_file=certificate,
            **{f"tls_{role}_cert": certificate for role in ("scheduler", "worker", "client")},
            **{f"tls_{role}_key": key for role in ("scheduler", "worker", "client")},
        )
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _make_certificate() -> dict[str, bytes]:
    """The files of a certificate and its key. Dask's are not valid where a clock is a second behind."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "pepperscene")])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCK_DIFFERENCE)
        .not_valid_after(now + _VALIDITY)
        .sign(key, hashes.SHA256())
    )
    return {
        "certificate.pem": certificate.public_bytes(serialization.Encoding.PEM),
        "key.pem": key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        ),
    }


def _write_private(files: dict[str, bytes], parents: Sequence[Path]) -> Path:
    """Write files that only this user can read into a new folder."""
    problems = []
    for parent in parents:
        problem = _exposure(parent)
        if problem is None:
            try:
                # The next build removes the folder of a build that was killed.
                folder = temporary_path(Path(os.path.abspath(parent)) / "credentials")
                folder.mkdir(mode=0o700)
                for name, content in files.items():
                    descriptor = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
                    with open(descriptor, "wb") as file:
                        file.write(content)
                return folder
            except OSError as error:
                problem = f"{parent} cannot be written to ({error.strerror})"
        problems.append(problem)
    raise SetupError(
        f"there is no safe folder for the key of this build: {', and '.join(problems)}; name one in "
        "credentials_directory that the nodes see and only you may write to"
    )


def _exposure(folder: Path) -> str | None:
    """How other users could replace a folder in this one by another; None if they cannot.

    As of OpenSSH for its keys: neither the folder nor one above may belong to others or be writable by
    others. Folders such as /tmp are allowed, in which everybody may rename only what is their own.
    """
    # The owner of the root folder controls the machine; in some containers, root has another number.
    trusted = {0, os.getuid(), os.stat("/").st_uid}
    try:
        resolved = folder.resolve(strict=True)
        for path in (resolved, *resolved.parents):
            status = path.stat()
            if not stat.S_ISDIR(status.st_mode):
                return f"{folder} is not a folder"
            if status.st_uid not in trusted:
                return f"{path} belongs to another user"
            if status.st_mode & _OTHERS_MAY_WRITE and not status.st_mode & stat.S_ISVTX:
                return f"other users may write to {path}"
    except (OSError, RuntimeError) as error:
        return f"{folder} cannot be used ({getattr(error, 'strerror', None) or error})"
    return None


def check_configured_credentials(address: str) -> None:
    """Raise `ArgumentError` if an address needs credentials and Dask's configuration has no valid ones."""
    import dask
    from distributed.comm import parse_address
    from distributed.security import Security

    # A site may have a function that gets credentials from elsewhere.
    if parse_address(address)[0] not in _ENCRYPTED or dask.config.get("distributed.client.security-loader"):
        return
    try:
        security = Security()
        tls = security.get_tls_config_for_role("client")
        if tls["ca_file"] and tls["cert"]:
            security.get_connection_args("client")
            return
    except (OSError, ValueError) as error:
        raise ArgumentError(
            "scheduler",
            f"{address} needs credentials, and those in Dask's configuration (distributed.comm.tls) "
            f"cannot be used: {error}",
        ) from None
    raise ArgumentError(
        "scheduler",
        f"{address} needs credentials: set distributed.comm.tls.ca-file, distributed.comm.tls.client.cert "
        "and distributed.comm.tls.client.key in Dask's configuration to the paths of their files",
    )


def trusts_network(address: str) -> bool:
    """Whether everybody who reaches an address from other machines can use it."""
    from distributed.comm import get_address_host, parse_address
    from distributed.utils import ensure_ip

    if parse_address(address)[0] not in ("tcp", "ws"):
        return False
    try:
        return not ip_address(ensure_ip(get_address_host(address))).is_loopback
    except (OSError, ValueError):
        return True

"""Dask's scheduler and worker without their HTTP servers, which would answer anybody."""

from __future__ import annotations

from typing import Any, Final, final

from distributed import Scheduler, Worker
from distributed.comm import get_address_host
from distributed.utils import get_ip


@final
class SchedulerWithoutHttp(Scheduler):
    """A scheduler whose only port is the one for its workers and clients."""

    def start_http_server(self, *_args: Any, **_options: Any) -> None:
        """Start nothing: Dask has no option for that, only for the dashboard, which is one page of it."""


@final
class WorkerWithoutHttp(Worker):
    """A worker whose only port is the one for the cluster, on one interface."""

    def __init__(self, scheduler_ip: str, **options: Any) -> None:
        if not options.get("host") and not options.get("interface"):
            # Without a host, a worker listens on all interfaces; it needs only the one towards the scheduler.
            options["host"] = get_ip(get_address_host(scheduler_ip))
        super().__init__(scheduler_ip, **options)

    def start_http_server(self, *_args: Any, **_options: Any) -> None:
        """Start nothing, as above."""


WORKER_CLASS: Final = f"{WorkerWithoutHttp.__module__}.{WorkerWithoutHttp.__name__}"
"""For the command line of `dask worker`."""

"""Jobs small enough to know their results."""

import logging
import os
import signal
import threading
import time

from threadpoolctl import threadpool_info

from casid.jobs.campaigns import Job, UnfinishedError
from casid.threads import on_all_cores

HERE = {"told": "nothing"}  # what a process knows that has loaded this


def add(payload, start):
    """Sum of the payload and the result it starts from."""
    if payload is None:
        raise ValueError("nothing to add")
    if payload == "best":
        raise UnfinishedError("halfway", 7)
    if payload == "long":
        time.sleep(0.2)
        return 0
    if payload == "die":
        os._exit(1)
    return payload + (start or 0)


def surroundings(payload, start):  # noqa: ARG001
    """What the process a job runs in knows, tells, ends by, and its threads of linear algebra."""
    threads = [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]
    own = signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    return [HERE["told"], logging.getLogger("casid").isEnabledFor(logging.INFO), own, max(threads)]


def job(name, payload, *after, key="key", alone=True):
    return Job(name=name, key=key, payload=payload, after=after, alone=alone)


def results(done):
    return {name: (each.result, each.reason, each.source) for name, each in done.items()}


def sharing(_, __):
    """How many threads two pieces of work have that wait a while for each other."""
    pair = threading.Barrier(2)

    def meet(_):
        try:
            pair.wait(0.2)
        except threading.BrokenBarrierError:
            pair.reset()
        return threading.get_ident()

    return len(set(on_all_cores(meet, range(2))))

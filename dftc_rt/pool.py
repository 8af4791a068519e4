"""A few worker processes, each with single-threaded linear algebra.

What is computed here works on small dense matrices, many thousand times a second. Threads of the
BLAS library cost more than they give there, and with several workers on few cores they wait for
each other. Their number has to be in the environment before NumPy is imported, so workers are
new interpreters, not forks. They end with the process that started them, however that ends.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import select
import signal
import subprocess
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import Any, Final

from dftc_rt.errors import DftcError, EnvironmentLacksError

_ONE_THREAD: Final = (
    "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "OMP_NUM_THREADS",
)  # fmt: skip
_START: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[2]); "
    "from dftc_rt.pool import serve; serve(int(sys.argv[1]))"
)
_RESULT, _ITEM, _ERROR, _REFUSED = "result", "item", "error", "refused"
_PATIENCE_S: Final = 5.0  # for a worker that was told to end


@dataclass(frozen=True)
class Task:
    """Something to compute.

    Attributes:
        name: Key of the result, unique.
        function: Function at the top level of a module, so that a worker finds it by name. What
            a generator yields is handed on at once; its result is None.
        arguments: What it is called with.
        lane: Tasks of one lane go to one worker while others have work of their own: what the
            first of them compiles serves the rest.
    """

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    lane: int = 0


def available() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def run(
    tasks: Sequence[Task],
    workers: int,
    done: Callable[[Task], None] = lambda task: None,
    item: Callable[[Task, Any], None] = lambda task, value: None,
) -> dict[str, Any]:
    """Compute all tasks; return name -> result.

    Args:
        tasks: What to compute.
        workers: Number of processes, at least 1.
        done: Called after every task, in this process.
        item: Called with everything that a generator yields, in this process.

    Raises:
        DftcError: A task raised one: it is handed on as it was.
        RuntimeError: A task raised something else; its traceback is the text.
        EnvironmentLacksError: A worker was killed, mostly for want of memory.
    """
    lanes: dict[int, deque[Task]] = {}
    for task in tasks:
        lanes.setdefault(task.lane, deque()).append(task)
    order = sorted(lanes)
    results: dict[str, Any] = {}
    with _workers(min(workers, len(tasks))) as links:
        home = {link: order[k % len(order)] for k, link in enumerate(links)}
        busy: dict[Connection[Any, Any], Task] = {}
        idle = list(links)
        while len(results) < len(tasks):
            for link in idle:
                if (following := _next(lanes, home[link])) is not None:
                    link.send((following.function, following.arguments))
                    busy[link] = following
            ready = wait(list(busy))
            idle = []
            for link in (link for link in links if link in ready):
                task = busy[link]
                try:
                    what, value = link.recv()
                except (EOFError, ConnectionError):
                    raise EnvironmentLacksError(
                        f"a worker process was killed during '{task.name}'",
                        "free some memory, and try again",
                    ) from None
                if what == _REFUSED:
                    raise value
                if what == _ERROR:
                    raise RuntimeError(f"{task.name}: {value}")
                if what == _ITEM:
                    item(task, value)
                    continue
                del busy[link]
                idle.append(link)
                results[task.name] = value
                done(task)
    return results


def _next(lanes: dict[int, deque[Task]], home: int) -> Task | None:
    """The first task of the home lane, else the last of the fullest lane."""
    if lanes[home]:
        return lanes[home].popleft()
    fullest = max(lanes.values(), key=len)
    return fullest.pop() if fullest else None


@contextlib.contextmanager
def _workers(count: int) -> Iterator[list[Connection[Any, Any]]]:
    """Start workers; end them whatever happens."""
    environment = os.environ | dict.fromkeys(_ONE_THREAD, "1")
    links: list[Connection[Any, Any]] = []
    processes: list[subprocess.Popen[bytes]] = []
    try:
        for _ in range(count):
            ours, theirs = Pipe()
            links.append(ours)
            command = [sys.executable, "-c", _START, str(theirs.fileno()), json.dumps(sys.path)]
            # A session of its own: Ctrl-C is for the process that waits, which ends them.
            processes.append(
                subprocess.Popen(
                    command, env=environment, stdin=subprocess.DEVNULL, stdout=2,
                    pass_fds=(theirs.fileno(),), start_new_session=True,
                )
            )  # fmt: skip
            theirs.close()
        yield links
    finally:
        for link in links:
            link.close()
        for process in processes:
            process.terminate()
        for process in processes:
            try:
                process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def serve(descriptor: int) -> None:
    """Be a worker: compute what comes in, until the other side closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    link: Connection[Any, Any] = Connection(descriptor)
    threading.Thread(target=_end_with_parent, args=(descriptor,), daemon=True).start()
    while True:
        try:
            function, arguments = link.recv()
        except (EOFError, ConnectionError):
            return
        answer: tuple[str, Any]
        try:
            result = function(*arguments)
            if inspect.isgenerator(result):
                for value in result:
                    link.send((_ITEM, value))
                result = None
            answer = (_RESULT, result)
        except DftcError as error:
            answer = (_REFUSED, error)
        except Exception:
            answer = (_ERROR, traceback.format_exc())
        link.send(answer)


def _end_with_parent(descriptor: int) -> None:
    """End at once when the other side closes, also in the middle of a task."""
    poll = select.poll()
    poll.register(descriptor, select.POLLRDHUP)
    poll.poll()
    os._exit(0)

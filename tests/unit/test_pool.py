"""The workers: lanes, single-threaded linear algebra, errors, and a worker that is killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator

import pytest

from dftc_rt.errors import EnvironmentLacksError, InputError, MissingFileError
from dftc_rt.pool import Task, run


def threads_and_pid() -> tuple[str, int]:
    return os.environ["OPENBLAS_NUM_THREADS"], os.getpid()


def double(value: int) -> int:
    return 2 * value


def counted(first: int) -> Iterator[int]:
    yield from range(first, first + 3)


def breaks_later() -> Iterator[int]:
    yield 1
    raise ValueError("on purpose")


def broken() -> None:
    raise ValueError("on purpose")


def refused() -> None:
    raise InputError("a.toml: key", "found 1", "2")


def not_there() -> None:
    raise MissingFileError("a.toml", "no such file", "a file")


def killed() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_results_by_name_and_progress() -> None:
    seen: list[str] = []
    tasks = [Task(f"{k}", double, (k,), k % 2) for k in range(7)]
    assert run(tasks, 2, lambda task: seen.append(task.name)) == {f"{k}": 2 * k for k in range(7)}
    assert sorted(seen) == [f"{k}" for k in range(7)]


def test_workers_have_one_thread_and_this_process_keeps_its_own() -> None:
    before = os.environ.get("OPENBLAS_NUM_THREADS")
    found = run([Task("a", threads_and_pid), Task("b", threads_and_pid)], 1)
    assert {threads for threads, _ in found.values()} == {"1"}
    assert os.getpid() not in {pid for _, pid in found.values()}
    assert os.environ.get("OPENBLAS_NUM_THREADS") == before


def test_one_worker_does_all_lanes() -> None:
    tasks = [Task(f"{k}", double, (k,), k) for k in range(3)]
    assert run(tasks, 1) == {"0": 0, "1": 2, "2": 4}


@pytest.mark.parametrize(("task", "kind"), [(refused, InputError), (not_there, MissingFileError)])
def test_bad_input_found_by_a_worker_comes_out_as_it_was(
    task: Callable[[], None], kind: type[InputError]
) -> None:
    with pytest.raises(kind) as caught:
        run([Task("a", task)], 1)
    with pytest.raises(kind) as here:
        task()
    assert str(caught.value) == str(here.value)
    assert (caught.value.where, caught.value.exit_code) == (here.value.where, 2)


def test_an_error_in_a_task_comes_out_with_its_traceback() -> None:
    with pytest.raises(RuntimeError, match=r"(?s)bad: .*on purpose"):
        run([Task("good", double, (1,)), Task("bad", broken)], 2)


def test_a_killed_worker_is_a_lack_of_the_machine() -> None:
    with pytest.raises(EnvironmentLacksError, match="killed during 'dead'"):
        run([Task("dead", killed)], 1)


def test_nothing_to_do() -> None:
    assert run([], 2) == {}


def test_what_a_generator_yields_comes_as_it_is_made() -> None:
    seen: list[tuple[str, int]] = []
    order: list[str] = []

    def item(task: Task, value: int) -> None:
        seen.append((task.name, value))
        order.append("item")

    tasks = [Task("a", counted, (0,)), Task("b", counted, (10,)), Task("c", double, (4,))]
    found = run(tasks, 2, lambda task: order.append(task.name), item)
    assert found == {"a": None, "b": None, "c": 8}
    assert [value for name, value in seen if name == "a"] == [0, 1, 2]
    assert [value for name, value in seen if name == "b"] == [10, 11, 12]
    assert order.index("item") < order.index("a")


def test_what_came_before_an_error_is_not_lost() -> None:
    seen: list[int] = []
    with pytest.raises(RuntimeError, match="on purpose"):
        run([Task("a", breaks_later)], 1, item=lambda task, value: seen.append(value))
    assert seen == [1]

"""Workers: answers, faults and deaths of processes that are forked from this one."""

import errno
import os
import signal
import time

import numpy as np
import pytest

from crankorder.batch.workers import FORKS, LEAST_BYTES, SharedPages, Worker, WorkerDiedError, each
from crankorder.errors import InputError

needs_fork = pytest.mark.skipif(not FORKS, reason="workers are threads here")


def answers(task, count, *, jobs):
    return dict(each(task, count, jobs=jobs))


@pytest.mark.cases(1)
@pytest.mark.parametrize("jobs", [2, 1, 5])
def test_every_task_is_done_once_whatever_the_number_of_workers(jobs):
    made = answers(lambda number: number**2, 4, jobs=jobs)
    assert {number: answer() for number, answer in made.items()} == {0: 0, 1: 1, 2: 4, 3: 9}


def test_an_error_of_one_task_comes_out_as_it_is_and_the_others_go_on():
    def task(number):
        if number == 1:
            raise InputError("no samples", file="b.h5", remedy="Leave it out")
        return number

    made = answers(task, 3, jobs=2)
    assert (made[0](), made[2]()) == (0, 2)
    with pytest.raises(InputError, match=r"b\.h5: no samples") as caught:
        made[1]()
    assert caught.value.remedy == "Leave it out"


def test_an_error_that_cannot_be_sent_still_says_what_it_was():
    class LocalError(Exception):
        def __reduce__(self):
            raise TypeError("cannot be sent")

    def task(number):
        raise LocalError("what happened")

    made = answers(task, 1, jobs=1)
    with pytest.raises(Exception, match="what happened"):
        made[0]()


@needs_fork
@pytest.mark.parametrize("jobs", [2, 1])  # of one worker, the next task was asked ahead of its death
def test_a_worker_that_is_killed_takes_one_task_with_it_and_names_the_signal(jobs):
    def task(number):
        if number == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    made = answers(task, 6, jobs=jobs)
    assert sorted(made) == list(range(6))
    assert [made[number]() for number in (0, 1, 3, 4, 5)] == [0, 1, 3, 4, 5]
    with pytest.raises(WorkerDiedError, match="SIGKILL"):
        made[2]()


@needs_fork
def test_workers_end_when_their_task_is_given_up():
    pids = []
    for _, answer in each(lambda number: (os.getpid(), time.sleep(0.01)), 8, jobs=2):
        pids.append(answer()[0])
        break
    for _, answer in each(lambda number: os.getpid(), 2, jobs=2):
        pids.append(answer())
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


@needs_fork
def test_workers_of_a_worker_end_with_it():
    def outer(_):
        return [answer() for _, answer in each(lambda number: os.getppid(), 2, jobs=2)] + [os.getpid()]

    worker = Worker(outer)
    worker.ask(None)
    *parents, own = worker.answer()
    worker.close()
    assert parents == [own, own]


def test_a_worker_answers_in_the_order_of_the_requests():
    worker = Worker(lambda request: request * 2)
    for request in (1, 2, 3):
        worker.ask(request)
    assert [worker.answer() for _ in range(3)] == [2, 4, 6]
    worker.close()


@pytest.mark.cases(1)
@needs_fork
@pytest.mark.parametrize("size", [1, LEAST_BYTES // 8 - 1, LEAST_BYTES // 8, 1_000_003])
def test_arrays_come_back_bit_for_bit_and_outlive_their_worker(size):
    def task(number):
        return {"frames": np.random.default_rng(number).normal(size=(2, size)), "number": number}

    made = {number: answer() for number, answer in answers(task, 5, jobs=2).items()}
    for number, answer in made.items():
        assert answer["number"] == number
        np.testing.assert_array_equal(answer["frames"], task(number)["frames"])
        answer["frames"] += 1.0  # as writable as any array


@needs_fork
def test_without_room_for_shared_pages_all_goes_through_the_pipe(monkeypatch):
    for name in ("MOST_BYTES", "MEMORY_BYTES"):
        monkeypatch.setattr(f"crankorder.batch.workers.{name}", 1 << 16)
    made = answers(lambda number: np.full(20_000, float(number)), 3, jobs=1)
    for number, answer in made.items():
        np.testing.assert_array_equal(answer(), np.full(20_000, float(number)))


@pytest.mark.cases(1)
@needs_fork
@pytest.mark.parametrize("room", [0, 1, 3])
def test_what_memory_does_not_hold_lies_in_a_file_and_on_a_full_disk_goes_through_the_pipe(monkeypatch, room):
    claimed = []

    def full(*arguments):
        claimed.append(arguments)
        if len(claimed) > room:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("crankorder.batch.workers.MEMORY_BYTES", 1 << 16)
    monkeypatch.setattr("crankorder.batch.workers.CLAIMED_BYTES", 1 << 12)
    monkeypatch.setattr("os.posix_fallocate", full)
    pages = SharedPages()
    arrays = [np.full(20_000, float(number)) for number in range(6)]
    said = [pages.put(array) for array in arrays]
    assert sum(bool(places) for _, places in said) == room
    assert all(on_disk for _, places in said for on_disk, _, _ in places)
    for packed, array in zip(said, arrays, strict=True):
        np.testing.assert_array_equal(pages.get(packed), array)


def test_what_is_to_be_done_meanwhile_is_done_once_while_tasks_wait_for_it(tmp_path):
    def task(number):
        while not (tmp_path / "done").exists():
            time.sleep(0.001)
        return number

    made = dict(each(task, 3, jobs=2, meanwhile=lambda: (tmp_path / "done").touch(exist_ok=False)))
    assert sorted(answer() for answer in made.values()) == [0, 1, 2]


@pytest.mark.cases(1)
@needs_fork
@pytest.mark.parametrize("fault", [None, "error", "death"])
def test_where_one_worker_begins_the_others_find_what_it_has_left(tmp_path, fault):
    left = tmp_path / "kernels"

    def task(number):
        found = left.exists()
        if number == 0 and fault == "error":
            raise InputError("no samples", file="b.h5", remedy="Leave it out")
        if number == 0 and fault == "death":
            os.kill(os.getpid(), signal.SIGKILL)
        if not found:
            time.sleep(0.05)
            left.touch(exist_ok=False)  # twice is a fault
        return os.getpid(), found

    made = dict(each(task, 9, jobs=3, one_first=True))
    assert sorted(made) == list(range(9))
    answers = [made[number]() for number in range(0 if fault is None else 1, 9)]
    assert [found for _, found in answers] == [False] + [True] * (len(answers) - 1)
    assert len({pid for pid, _ in answers}) == 3


@pytest.mark.slow
@needs_fork
def test_where_one_worker_begins_and_nothing_succeeds_every_fault_is_told():
    def task(number):
        raise InputError(f"no samples in {number}", file="b.h5", remedy="Leave it out")

    made = dict(each(task, 4, jobs=2, one_first=True))
    for number in range(4):
        with pytest.raises(InputError, match=f"no samples in {number}"):
            made[number]()


@needs_fork
def test_a_dead_worker_says_so_every_time_it_is_asked():
    worker = Worker(lambda request: os.kill(os.getpid(), signal.SIGKILL))
    for said in ("SIGKILL", "ended before"):
        worker.ask(1)
        with pytest.raises(WorkerDiedError, match=said):
            worker.answer()
    worker.close()

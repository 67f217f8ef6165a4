"""Workers: answers, faults and deaths of processes that are forked from this one."""

from __future__ import annotations

import os
import signal
import time

import pytest

from crankorder.batch.workers import FORKS, Worker, WorkerDiedError, each
from crankorder.errors import InputError

needs_fork = pytest.mark.skipif(not FORKS, reason="workers are threads here")


def answers(task, count, *, jobs):
    return dict(each(task, count, jobs=jobs))


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_every_task_is_done_once_whatever_the_number_of_workers(jobs):
    made = answers(lambda number: number**2, 4, jobs=jobs)
    assert {number: answer() for number, answer in made.items()} == {0: 0, 1: 1, 2: 4, 3: 9}


def test_no_task_needs_no_worker():
    assert answers(lambda number: number, 0, jobs=2) == {}


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
def test_a_worker_that_is_killed_takes_one_task_with_it_and_names_the_signal():
    def task(number):
        if number == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    made = answers(task, 6, jobs=2)
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

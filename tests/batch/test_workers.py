"""Workers: answers, faults and deaths of processes that are forked from this one."""

import os
import signal
import time

import numpy as np
import pytest

from crankorder.batch.workers import TooLateError, Worker, WorkerDiedError, each
from crankorder.errors import InputError


class LocalError(Exception):
    def __reduce__(self):
        raise TypeError("cannot be sent")


def raising(error):
    def task():
        raise error

    return task


@pytest.mark.cases(12)
@pytest.mark.parametrize("jobs", [2, 1])
@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        (
            raising(InputError("no samples", file="b.h5", remedy="Leave it")),
            InputError,
            r"b\.h5: no samples\. Leave it",
        ),
        (raising(LocalError("what happened")), RuntimeError, "LocalError: what happened"),
        (raising(SystemExit("a library ends it")), RuntimeError, "SystemExit: a library ends it"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), WorkerDiedError, "ended by SIGKILL"),
        (lambda: os._exit(3), WorkerDiedError, "ended with status 3"),
        (lambda: time.sleep(600.0), TooLateError, "longer than 2 s"),
    ],
)
def test_each_task_has_its_own_answer_and_what_befalls_one_is_blamed_on_it_alone(fault, kind, words, jobs):
    def task(number):
        return fault() if number == 2 else number**2

    made = dict(each(task, 6, jobs=jobs, timeout_s=2.0))
    with pytest.raises(kind, match=words):
        made.pop(2).result()
    assert {number: answer.result() for number, answer in made.items()} == {0: 0, 1: 1, 3: 9, 4: 16, 5: 25}


def test_no_worker_outlives_the_tasks_whether_they_are_done_or_given_up():
    pids = [answer.result() for _, answer in each(lambda number: os.getpid(), 2, jobs=2)]
    for _, answer in each(lambda number: (os.getpid(), time.sleep(0.01))[0], 8, jobs=2):
        pids.append(answer.result())
        break
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_workers_of_a_worker_end_with_it():
    """Killed while they wait: nobody is left who could end them."""

    def outer(_):
        own = next(each(lambda number: (os.getppid(), os.getpid()), 1, jobs=1))[1].result()
        return own, Worker(lambda _: None)._process.pid

    worker = Worker(outer, daemon=False)
    worker.ask(None)
    (parent, _), left = worker.answer()
    assert parent == worker._process.pid
    os.kill(left, 0)
    worker.close()
    with pytest.raises(ProcessLookupError):
        for _ in range(1000):
            os.kill(left, 0)
            time.sleep(0.01)


def test_a_worker_answers_in_the_order_of_the_requests():
    worker = Worker(lambda request: request * 2)
    for request in (1, 2, 3):
        worker.ask(request)
    assert [worker.answer() for _ in range(3)] == [2, 4, 6]
    worker.close()


def test_arrays_come_back_bit_for_bit_and_outlive_their_worker():
    def task(number):
        return np.random.default_rng(number).normal(size=(2, 10**number))

    for number, answer in each(task, 6, jobs=2):
        np.testing.assert_array_equal(answer.result(), task(number))


def test_a_dead_worker_says_so_every_time_it_is_asked():
    worker = Worker(lambda _: os.kill(os.getpid(), signal.SIGKILL))
    for _ in range(2):
        worker.ask(1)
        with pytest.raises(WorkerDiedError, match="SIGKILL"):
            worker.answer()
    worker.close()

"""One process at a time where several write."""

import errno
import multiprocessing
import os
import signal
import time

import pytest

from crankorder.batch import store
from crankorder.batch.store import locked
from crankorder.errors import EnvironmentFailure

FORK = multiprocessing.get_context("fork")


def add_one(place, rounds):
    for _ in range(rounds):
        with locked(place):
            count = int(place.read_text())
            time.sleep(0.0005)
            place.write_text(str(count + 1))


def test_four_processes_count_without_losing_one(tmp_path):
    place = tmp_path / "count"
    place.write_text("0")
    processes = [FORK.Process(target=add_one, args=(place, 25)) for _ in range(4)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert place.read_text() == "100"
    assert [path.name for path in tmp_path.iterdir()] == ["count"]


def hold(place, ready):
    with locked(place):
        ready.set()
        time.sleep(600)


def test_the_lock_of_a_killed_process_is_free_and_the_waiting_one_says_whom_it_waits_for(tmp_path):
    ready, told = FORK.Event(), []
    holder = FORK.Process(target=hold, args=(tmp_path / "test", ready), daemon=True)
    holder.start()

    def tell(text):
        told.append(text)
        os.kill(holder.pid, signal.SIGKILL)

    try:
        ready.wait()
        with locked(tmp_path / "test", tell=tell):
            assert len(told) == 1 and f"process {holder.pid}" in told[0] and told[0].startswith("test: waiting")
    finally:
        holder.kill()
        holder.join()


def test_a_place_that_cannot_be_written_is_said_to_be_so(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(EnvironmentFailure, match="file"), locked(tmp_path / "file" / "test"):
        pass


def test_f7_a_disk_without_locks_is_told_of_where_something_is_written(tmp_path, monkeypatch):
    left = [errno.ENOLCK, 37, 77, errno.ENOSYS, errno.EOPNOTSUPP, errno.EIO]

    def refused(handle, operation):
        raise OSError(left[0], os.strerror(left.pop(0)))

    monkeypatch.setattr(store.fcntl, "flock", refused)
    for number in left[:-1]:
        told = []
        with locked(tmp_path / str(number), tell=told.append):
            assert told == [f"{number}: this disk knows no locks: let no other run write there at the same time"]
    with pytest.raises(EnvironmentFailure), locked(tmp_path / "test"):  # a lock that fails in another way
        pass

"""A disk that fails at the n-th call of a whole run: exit status 5, and what stands there is whole, old or new."""

import errno
import json
import os
import shutil

import pytest

from made.command import crankorder, results_in

MOST_CALLS = 80
DONE, ENVIRONMENT = 0, 5


def run(folder, out, max_order):
    recipe = folder.with_name("recipe.toml")
    results = '[report]\nresults = ["order_map"]\npictures = false\n'
    recipe.write_text(f'title = "a map"\n[orders]\nmax_order = {max_order}\n{results}', encoding="utf-8")
    return crankorder("run", folder, "--out", out, "--recipe", recipe, "--jobs", "1", "-q")


@pytest.fixture(scope="module")
def folder(recordings_of, tmp_path_factory):
    return shutil.copytree(recordings_of("hard-two-revolutions"), tmp_path_factory.mktemp("scene") / "test")


@pytest.fixture(scope="module")
def both(folder, tmp_path_factory):
    """A folder of old results beside which frames of new ones are kept, the old results, the new ones."""
    old, new = (tmp_path_factory.mktemp("results") / name for name in ("old", "new"))
    assert run(folder, old, 12).exit_code == DONE
    shutil.copytree(old, new)
    made = run(folder, new, 8)
    assert made.exit_code == DONE, made.output
    return old, results_in(old), results_in(new)


@pytest.mark.parametrize(("call", "fault"), [("rename", errno.EIO), ("replace", errno.ENOSPC)])
def test_f3_i4_whichever_call_of_a_whole_run_fails_the_old_results_are_whole_or_the_new_ones(
    folder, both, tmp_path, monkeypatch, call, fault
):
    """Each time one more call goes well, until all do; both calls change the disk."""
    place, old, new = both
    assert old != new
    real = getattr(os, call)
    for number in range(MOST_CALLS):
        out = tmp_path / str(number)
        shutil.copytree(place, out)
        left = [number]

        def fails(*given, left=left, **named):  # type: ignore[no-untyped-def]
            left[0] -= 1
            if left[0] == -1:
                raise OSError(fault, os.strerror(fault), str(given[0]))
            return real(*given, **named)

        with monkeypatch.context() as patched:
            patched.setattr(os, call, fails)
            made = run(folder, out, 8)
        assert made.exit_code in (DONE, ENVIRONMENT), made.output
        assert "Traceback" not in made.output
        assert made.exit_code == DONE or os.strerror(fault) in made.output
        found = results_in(out)
        of_test = [{name: data for name, data in one.items() if "/" in name} for one in (found, old, new)]
        assert of_test[0] in of_test[1:], sorted(found)
        if found["batch.json"] not in (old["batch.json"], new["batch.json"]):  # then it says that this run failed
            [told] = json.loads(found["batch.json"])["tests"]
            assert told["status"] == "failed" and made.exit_code == ENVIRONMENT
        assert run(folder, out, 8).exit_code == DONE
        assert results_in(out) == new
        shutil.rmtree(out)
        if left[0] >= 0:
            return
    raise AssertionError("more calls than were tried")

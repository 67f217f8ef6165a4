"""The cross-check by another program says what to do where that is absent."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from crankorder.errors import CrankorderError
from crankorder.identify.modal.crosscheck import crosscheck_with_pyoma


def test_without_pyoma_the_cross_check_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyoma2", None)
    monkeypatch.setitem(sys.modules, "pyoma2.algorithms", None)
    with pytest.raises(CrankorderError, match="crankorder\\[modal\\]"):
        crosscheck_with_pyoma(np.zeros((1, 100)), rate_hz=100.0)

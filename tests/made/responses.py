"""Response of poles by their definition, as the truth of what integrates them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crankorder.synth.poles import Poles


def frequency_response(poles: Poles, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Complex acceleration per force (1/kg) of ``poles`` in the steady state, shape (channel, axis, frequency).

    ``frequency_hz``: any sign, shape (frequency,).
    """
    s = 2j * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    near, far = 0.5 / (s - poles.pole_per_s[:, None]), 0.5 / (s - poles.pole_per_s.conj()[:, None])
    response = np.einsum("cp,pa,pf->caf", poles.output, poles.input, near)
    response += np.einsum("cp,pa,pf->caf", poles.output.conj(), poles.input, far)
    return response + poles.direct[:, :, None]

"""Two lines in one bin solved together: their orders, amplitudes and errors by least squares over all frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.orders.averages import frame_correlation
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-lines.toml", table="close_pair"):
    slow_waves: int
    side_bins: int


NUMBERS = _Numbers.load()

STEPS = 12
"""Gauss-Newton steps: a start within half a cycle of the recording needs six."""

SETTLED = 1e-9
"""Cycles over the recording by which a step moves lines that are found."""

LONGEST_STEP = 0.25
"""Cycles over the recording by which a step moves a line at most."""

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pair:
    """Two lines: their ``offset`` and ``variance`` (2,) [orders], amplitudes and errors (channels, 2).

    ``amplitude`` is complex, at the middle of the recording; ``error``, with ``degrees_of_freedom``, is its standard
    error along one axis.
    """

    offset: Floats
    variance: Floats
    amplitude: Complex
    error: Floats
    degrees_of_freedom: float


def solved_pair(phasors: Complex, turn: Floats, *, revs: float, offset: tuple[float, float]) -> Pair | None:
    """The two lines near ``offset`` that leave least of ``phasors``; None where these do not settle apart.

    Both turn by exact steps from frame to frame; amplitudes follow linearly from the orders and are eliminated (Golub
    and Pereyra 1973). Frames that overlap share noise and are made white first. Channels may share noise too: the
    errors allow for what is left of them together.

    Parameters
    ----------
    phasors : (channels, frames), complex amplitudes in one bin
    turn : (frames,), rev, crank angle of the middle of each frame from that of the recording
    revs : rev, length of a frame
    offset : orders from the bin at which the search begins
    """
    n, span = len(turn), float(np.ptp(turn))
    shared = frame_correlation(turn, np.zeros(n, dtype=np.int64), revs_per_frame=revs, window="hann")
    white = np.linalg.inv(np.linalg.cholesky(shared + 1e-9 * np.eye(n)))
    data, at = white @ phasors.T, np.array(offset)
    for _ in range(STEPS):
        basis, slopes = _bases(white, turn, at)
        amplitude, left, inverse = _linear(basis, data)
        noise = np.maximum(np.square(np.abs(left)).sum(axis=0), 1e-24 * np.square(np.abs(data)).sum(axis=0))
        score, normal = _normal(_moved(basis, slopes, amplitude, inverse), left, 1.0 / noise)
        step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(2), score)
        if np.abs(step).max() * span < SETTLED:
            break
        at = at + np.clip(step, -LONGEST_STEP / span, LONGEST_STEP / span)
        if abs(at[1] - at[0]) * span < LONGEST_STEP:
            return None
    basis, slopes = _bases(white, turn, at)
    return _with_errors(basis, slopes, data, turn, at)


def _bases(white: Floats, turn: Floats, at: Floats) -> tuple[Complex, Complex]:
    """White waves (frames, 2) of lines ``at`` (2,) and their derivatives by it."""
    waves = np.exp(2j * np.pi * np.outer(turn, at))
    return white @ waves, white @ (2j * np.pi * turn[:, None] * waves)


def _linear(basis: Complex, data: Complex) -> tuple[Complex, Complex, Complex]:
    """Amplitudes (2, channels) of ``basis`` in ``data`` (frames, channels), what is left, and the inverse."""
    back = basis.conj().T
    inverse = np.asarray(np.linalg.solve(back @ basis, back), dtype=np.complex128)
    amplitude = inverse @ data
    return amplitude, data - basis @ amplitude, inverse


def _moved(basis: Complex, slopes: Complex, amplitude: Complex, inverse: Complex) -> Complex:
    """What moving each line changes beyond its amplitude: (2, channels, frames)."""
    change = slopes.T[:, None, :] * amplitude[:, :, None]
    return np.asarray(change - (change @ inverse.T) @ basis.T)


def _normal(moved: Complex, left: Complex, weight: Floats) -> tuple[Floats, Floats]:
    """Score (2,) and normal matrix (2, 2) of the orders from how these have ``moved``, channels by ``weight``."""
    scaled = moved * np.sqrt(weight)[None, :, None]
    rows = scaled.reshape(2, -1)
    score = (rows.conj() @ (left.T * np.sqrt(weight)[:, None]).ravel()).real
    return score, np.asarray((rows.conj() @ rows.T).real)


def _with_errors(basis: Complex, slopes: Complex, data: Complex, turn: Floats, at: Floats) -> Pair:
    amplitude, left, inverse = _linear(basis, data)
    n = len(left)
    degrees_of_freedom = max(2.0 * n - 4.0 - 2.0, 1.0)
    shared = left.conj().T @ left * (2.0 / degrees_of_freedom)  # noise power of the channels and what they share
    power = np.maximum(np.diag(shared).real, 1e-24 * np.square(np.abs(data)).mean(axis=0))
    weight = 1.0 / power
    moved = _moved(basis, slopes, amplitude, inverse)
    _, normal = _normal(moved, left, weight)
    back = np.linalg.inv(normal)
    middle = 0.5 * np.einsum("lcf,mdf,dc,c,d->lm", moved.conj(), moved, shared, weight, weight).real
    covariance = back @ middle @ back
    louder = np.array([_louder(left, turn, one) for one in at])
    turned = -np.einsum("bf,fl,lc->bcl", inverse, slopes, amplitude)  # how amplitudes follow the orders
    unit = amplitude / np.maximum(np.abs(amplitude), 1e-300)
    along = np.square((turned * unit.conj()[:, :, None]).real) @ np.diag(covariance)
    own = 0.5 * np.square(np.abs(inverse)).sum(axis=1)[:, None] * power[None, :]
    error = np.sqrt((own + along) * louder[:, None])
    return Pair(at, np.diag(covariance) * louder, np.asarray(amplitude.T), np.asarray(error.T), degrees_of_freedom)


def _louder(left: Complex, turn: Floats, at: float) -> float:
    """Power of slow waves about a line ``at`` in what is ``left`` (frames, channels) over that of all; 1 at least."""
    n = len(turn)
    if n < 4 * NUMBERS.slow_waves:
        return 1.0
    near = np.array([k for k in range(-NUMBERS.slow_waves, NUMBERS.slow_waves + 1) if k]) / float(np.ptp(turn)) + at
    waves = np.exp(-2j * np.pi * np.outer(near, turn))
    slow = np.square(np.abs(waves @ left)).mean(axis=0) / n
    return float(max(1.0, np.median(slow / np.maximum(np.square(np.abs(left)).mean(axis=0), 1e-300))))


def unaliased(
    phasors: Complex, turn: Floats, *, offsets: tuple[float, float], resolution: float, hop_rev: float
) -> float:
    """The second of two ``offsets``, moved by whole turns a step to where the bins beside say that it is.

    From frame to frame the phase of a line tells its order but for multiples of 1 / ``hop_rev``; the share that each
    bin holds of it tells which.

    Parameters
    ----------
    phasors : (channels, bins, frames) in ``side_bins`` bins on each side of that of the lines and in itself
    turn : (frames,), rev, crank angle of the middle of each frame from that of the recording
    offsets : orders from the bin, of the first line and the second
    resolution : orders, from bin to bin
    hop_rev : rev, from frame to frame
    """
    places = np.arange(phasors.shape[1]) - NUMBERS.side_bins
    back = phasors * np.exp(2j * np.pi * resolution * np.outer(places, turn))
    basis = np.exp(2j * np.pi * np.outer(turn, offsets))
    share = np.abs(np.einsum("f,cbf->cb", np.linalg.pinv(basis)[1], back))
    candidates = [offsets[1] + k / hop_rev for k in (-1, 0, 1)]
    scores = []
    for one in candidates:
        lobe = np.abs(np.sinc(one / resolution - places) / (1.0 - (one / resolution - places) ** 2 + 1e-9))
        scores.append(float((share @ lobe).sum() / np.linalg.norm(lobe)))
    return candidates[int(np.argmax(scores))]

"""Pixels: anti-aliased lines, areas, rings, text and images on a white sheet, and the PNG of it.

Written for pages of a few hundred strokes: a page costs milliseconds where a general plotting library's layout costs
a tenth of a second, and it needs nothing that is slow to import.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from crankorder.report.drawing.typeface import text_mask

Clip = tuple[int, int, int, int]
"""First column, first row, and the column and row after the last, within which is drawn."""

COMPRESSION_LEVEL = 2
"""Of PNG: rows are first taken as differences to the row above, so that little is left to compress."""


class Canvas:
    """A white sheet of ``width`` by ``height`` pixels; places count right and down from the top left corner."""

    def __init__(self, width: int, height: int) -> None:
        self.pixels = np.full((height, width, 3), 255, dtype=np.uint8)
        self._flat = self.pixels.reshape(-1, 3)
        self._cover = np.zeros(height * width, dtype=np.float32)

    @property
    def _whole(self) -> Clip:
        return 0, 0, self.pixels.shape[1], self.pixels.shape[0]

    def _within(self, clip: Clip | None) -> Clip:
        left, top, right, bottom = clip or self._whole
        return max(left, 0), max(top, 0), min(right, self.pixels.shape[1]), min(bottom, self.pixels.shape[0])

    def _blend(
        self,
        column: NDArray[np.int64],
        row: NDArray[np.int64],
        cover: NDArray[np.float32],
        rgb: tuple[int, int, int],
        alpha: float,
        clip: Clip,
        *,
        add: bool = False,
    ) -> None:
        """Lay ``rgb`` over pixels that may be named more than once: their covers add up or the largest counts."""
        inside = (cover > 0) & (column >= clip[0]) & (column < clip[2]) & (row >= clip[1]) & (row < clip[3])
        index = row[inside] * self.pixels.shape[1] + column[inside]
        (np.add if add else np.maximum).at(self._cover, index, cover[inside])
        share = np.minimum(self._cover[index], 1)[:, None] * np.float32(alpha)
        self._cover[index] = 0
        old = self._flat[index].astype(np.float32)
        self._flat[index] = (old + (np.array(rgb, dtype=np.float32) - old) * share + np.float32(0.5)).astype(np.uint8)

    def stroke(
        self,
        points: NDArray[np.float64],
        *,
        width: float,
        rgb: tuple[int, int, int],
        alpha: float = 1.0,
        clip: Clip | None = None,
    ) -> None:
        """Draw a line through ``points`` (n, 2), broken at NaN, with round joins and ends.

        ``width`` in pixels; colour ``rgb`` with opacity ``alpha``; only inside ``clip``.
        """
        box = self._within(clip)
        start, end = points[:-1], points[1:]
        reach = width / 2 + 1
        low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
        seen = (high[:, 0] > box[0]) & (low[:, 0] < box[2]) & (high[:, 1] > box[1]) & (low[:, 1] < box[3])
        start, end = start[seen], end[seen]  # a segment with NaN is not seen
        steep = np.abs(end[:, 1] - start[:, 1]) > np.abs(end[:, 0] - start[:, 0])
        found = [
            _near(start[which], end[which], width / 2, (box[axis], box[axis + 2]), axis)
            for axis, which in ((1, steep), (0, ~steep))
            if which.any()
        ]
        if found:
            column, row, cover = (np.concatenate(parts) for parts in zip(*found, strict=True))
            self._blend(column, row, cover, rgb, alpha, box)

    def rectangle(
        self, edges: Clip, *, rgb: tuple[int, int, int], alpha: float = 1.0, clip: Clip | None = None
    ) -> None:
        """Fill whole pixels between ``edges`` with ``rgb`` at opacity ``alpha``; only inside ``clip``."""
        box = self._within(clip)
        left, top, right, bottom = max(edges[0], box[0]), max(edges[1], box[1]), edges[2], edges[3]
        place = self.pixels[top : max(min(bottom, box[3]), top), left : max(min(right, box[2]), left)]
        colour = np.array(rgb, dtype=np.float32)
        place[...] = colour if alpha == 1 else place + (colour - place) * np.float32(alpha) + np.float32(0.5)

    def area(
        self,
        x: NDArray[np.float64],
        upper: NDArray[np.float64],
        lower: NDArray[np.float64],
        *,
        rgb: tuple[int, int, int],
        alpha: float,
        clip: Clip | None = None,
    ) -> None:
        """Fill between two curves over ascending ``x``: rows ``upper`` (the smaller number) to ``lower``, none at NaN.

        Colour ``rgb`` with opacity ``alpha``; only inside ``clip``.
        """
        box = self._within(clip)
        known = np.isfinite(x)
        first, last = max(np.floor(x[known].min(initial=0)), box[0]), min(np.ceil(x[known].max(initial=0)), box[2])
        place = np.arange(first + 0.25, last, 0.5)  # two samples a column
        top = np.clip(np.interp(place, x, upper, left=np.nan, right=np.nan), box[1], box[3])
        bottom = np.clip(np.interp(place, x, lower, left=np.nan, right=np.nan), box[1], box[3])
        kept = np.isfinite(top) & np.isfinite(bottom) & (bottom > top)
        place, top, bottom = place[kept], top[kept], bottom[kept]
        begin = np.floor(top).astype(np.int64)
        which, row = _runs(begin, np.ceil(bottom).astype(np.int64) - begin)
        cover = np.minimum(bottom[which], row + 1) - np.maximum(top[which], row)
        column = np.floor(place[which]).astype(np.int64)
        self._blend(column, row, (0.5 * cover).astype(np.float32), rgb, alpha, box, add=True)

    def rings(
        self,
        centres: NDArray[np.float64],
        *,
        radius: float,
        width: float,
        rgb: tuple[int, int, int],
        alpha: float = 1.0,
        clip: Clip | None = None,
    ) -> None:
        """Draw circles of ``radius`` pixels around ``centres`` (n, 2); full discs where ``width`` of the line is 0.

        Colour ``rgb`` with opacity ``alpha``; only inside ``clip``.
        """
        centres = centres[np.isfinite(centres).all(axis=1)]
        reach = int(np.ceil(radius + width / 2 + 1))
        around = np.arange(-reach, reach + 1)
        column = np.floor(centres[:, 0, None, None]).astype(np.int64) + around[None, None, :]
        row = np.floor(centres[:, 1, None, None]).astype(np.int64) + around[None, :, None]
        column, row = np.broadcast_arrays(column, row)
        away = np.hypot(column + 0.5 - centres[:, 0, None, None], row + 0.5 - centres[:, 1, None, None])
        cover = _overlap(np.abs(away - radius), width / 2) if width else np.clip(radius + 0.5 - away, 0, 1)
        self._blend(column.ravel(), row.ravel(), cover.astype(np.float32).ravel(), rgb, alpha, self._within(clip))

    def image(self, rgb: NDArray[np.uint8], left: int, top: int) -> None:
        """Set a block of pixels ``rgb`` (rows, columns, 3) with its first corner at ``left``, ``top``."""
        block = rgb[max(-top, 0) :, max(-left, 0) :]
        place = self.pixels[max(top, 0) :, max(left, 0) :][: block.shape[0], : block.shape[1]]
        place[...] = block[: place.shape[0], : place.shape[1]]

    def text(
        self,
        text: str,
        x: float,
        y: float,
        *,
        size_px: float,
        rgb: tuple[int, int, int],
        bold: bool = False,
        upward: bool = False,
    ) -> None:
        """Write ``text`` with the start of its baseline at ``x``, ``y``, in type of ``size_px`` and colour ``rgb``.

        ``bold`` or regular; ``upward`` reads from the bottom to the top.
        """
        along = -y if upward else x
        shift = np.floor(4 * (along - np.floor(along))) / 4
        mask, right, down = text_mask(text, size_px, bold=bold, shift_px=float(shift))
        left, top = int(np.floor(along)) + right, int(np.rint(x if upward else y)) + down
        if upward:
            mask = np.rot90(mask)
            left, top = top, -left - mask.shape[0]
        rows, columns = self.pixels.shape[:2]
        mask = mask[max(-top, 0) : max(rows - top, 0), max(-left, 0) : max(columns - left, 0)]
        place = self.pixels[max(top, 0) :, max(left, 0) :][: mask.shape[0], : mask.shape[1]]
        old = place.astype(np.float32)
        share = mask[..., None] * np.float32(1 / 255)
        place[...] = (old + (np.array(rgb, dtype=np.float32) - old) * share + np.float32(0.5)).astype(np.uint8)

    def png(self, *, dpi: int) -> bytes:
        """PNG of the sheet, marked with ``dpi``: the same bytes for the same pixels, no date."""
        height, width, _ = self.pixels.shape
        rows = self.pixels.reshape(height, 3 * width)
        filtered = np.empty((height, 1 + 3 * width), dtype=np.uint8)
        filtered[:, 0] = 2  # each row as its difference to the one above
        filtered[0, 1:] = rows[0]
        np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
        per_metre = round(dpi / 0.0254)
        return b"\x89PNG\r\n\x1a\n" + b"".join(
            (
                _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
                _chunk(b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1)),
                _chunk(b"tEXt", b"Software\x00crankorder"),
                _chunk(b"IDAT", zlib.compress(filtered.data, COMPRESSION_LEVEL)),
                _chunk(b"IEND", b""),
            )
        )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))


def _runs(first: NDArray[np.int64], length: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of the run and value of every integer of runs that begin at ``first`` and hold ``length`` of them."""
    length = np.maximum(length, 0)
    which = np.repeat(np.arange(len(first)), length)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(length) - length, length) + first[which]


def _overlap(away: NDArray[np.float64], half: float) -> NDArray[np.float64]:
    """Share of a pixel ``away`` from the middle of a line that the line covers; ``half`` its width."""
    return np.asarray(np.clip(np.minimum(away + 0.5, half) - np.maximum(away - 0.5, -half), 0, 1))


def _near(
    start: NDArray[np.float64], end: NDArray[np.float64], half: float, within: tuple[int, int], axis: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Columns, rows and covers of the pixels near segments that run more along ``axis`` (0: right, 1: down).

    ``start`` and ``end`` (n, 2); ``half`` the width; ``within`` first pixel along the axis and the one after the last.
    """
    a, b, c, d = start[:, axis], end[:, axis], start[:, 1 - axis], end[:, 1 - axis]
    first = np.maximum(np.floor(np.minimum(a, b) - half - 0.5), within[0]).astype(np.int64)
    last = np.minimum(np.ceil(np.maximum(a, b) + half + 0.5), within[1]).astype(np.int64)
    which, along = _runs(first, last - first)
    run, rise = (b - a)[which], (d - c)[which]
    p = along + 0.5 - a[which]
    square = np.maximum(run**2 + rise**2, 1e-12)
    middle = c[which] + np.clip(p * run / np.maximum(run**2, 1e-12), 0, 1) * rise
    reach = int(np.ceil(1.42 * half + 1))
    across = np.floor(middle).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
    q = across + 0.5 - c[which][:, None]
    share = np.clip((p[:, None] * run[:, None] + q * rise[:, None]) / square[:, None], 0, 1)
    away = np.hypot(p[:, None] - share * run[:, None], q - share * rise[:, None])
    cover = _overlap(away, half).astype(np.float32).ravel()
    lengthways = np.repeat(along, across.shape[1])
    pair = (lengthways, across.ravel()) if axis == 0 else (across.ravel(), lengthways)
    return *pair, cover

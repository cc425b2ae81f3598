"""Spectra of what a log holds: power densities by averaged windows (Welch), in numpy."""

from typing import Any

import numpy as np

from autopilot.core.frames import FloatArray

SEGMENT = 1024
"""Samples of a window at most: 10 s at 100 Hz."""
FEWEST = 64
"""With fewer samples there is no spectrum worth showing."""


def density(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Frequencies [Hz] and one-sided power density [unit**2/Hz] of a curve (n,), its mean left out.

    Samples are put on even steps of their median interval first; None where there are too few.
    """
    finite = np.isfinite(values)
    t_s, values = t_s[finite], values[finite]
    if len(t_s) < FEWEST:
        return None
    step_s = float(np.median(np.diff(t_s)))
    if step_s <= 0.0:
        return None
    even = np.interp(np.arange(t_s[0], t_s[-1], step_s), t_s, values)
    size = min(SEGMENT, len(even))
    if size < FEWEST:
        return None
    window = np.hanning(size)
    starts = range(0, len(even) - size + 1, size // 2)
    parts = np.stack([even[start : start + size] for start in starts])
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window
    power: Any = (np.abs(np.fft.rfft(parts, axis=1)) ** 2).mean(axis=0) * step_s / float((window**2).sum())
    power[1:-1] *= 2.0
    hz: Any = np.fft.rfftfreq(size, step_s)
    return hz[1:], power[1:]

"""Feedback of disturbances: whether a device moves by all that its torque has above the motion.

Outside a control loop, noise of a torque channel moves nothing: acceleration and torque are hardly coherent above the
motion. In a loop, a disturbance moves the device, the controller answers, and both have the same noise. Then the sign
of dry friction near reversals, and with it the delay, follows that noise.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.signals import hann_window, segment_spectra

# Band of the coherence over the motion's bandwidth, and its end as a share of the sampling rate.
_FROM, _TO, _HIGHEST = 3.0, 8.0, 0.4
# Periods of the bandwidth in a segment; segments at least, since fewer are coherent by chance; samples of one at least.
_PERIODS, _SEGMENTS, _SHORTEST = 4.0, 5, 16
# Mean coherence from which the two have the same noise. Logs outside loops have up to 0.7, by leakage of the motion.
_SAME = 0.9


def feeds_back(position: Array, torque: Array, dt: float, bandwidth: float) -> bool:
    """Whether any coordinate's acceleration is coherent with a torque above the motion.

    Args:
        position: of the coordinates, (coordinates, n), rad or m.
        torque: of the channels, (channels, n), in any unit.
        dt: s.
        bandwidth: of the motion, Hz.
    """
    length = min(round(_PERIODS / (bandwidth * dt)), position.shape[1] // _SEGMENTS)
    if length < _SHORTEST:
        return False
    window = hann_window(length)
    # The second difference has a flat spectrum where positions fall with the square of the frequency.
    moves = np.stack([segment_spectra(x, window) for x in np.diff(position, 2, axis=1)])
    acts = np.stack([segment_spectra(u, window) for u in torque[:, 1:-1]])
    f = np.fft.rfftfreq(length, dt)
    band = (f >= _FROM * bandwidth) & (f <= min(_TO * bandwidth, _HIGHEST / dt))
    if not band.any():
        return False
    moves, acts = moves[:, :, band], acts[:, :, band]
    both = np.abs(np.einsum("ksf,lsf->klf", moves, acts.conj())) ** 2
    alone = [np.sum(np.abs(one) ** 2, axis=1) for one in (moves, acts)]
    size = alone[0][:, None] * alone[1]
    coherence = np.mean(both / np.maximum(size, np.finfo(float).tiny), axis=2)
    return bool(coherence.max(initial=0.0) > _SAME)

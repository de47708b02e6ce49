"""Samples as they are recorded: frames on the network, the recorder, and what they say about a device meanwhile.

May import estimation, inference, experiment and study; it knows no page and no command.
"""

from haptid.live.analysis import LiveAnalysis, LiveSettings, analysed_study
from haptid.live.frames import FrameError, SampleFrame, pack_frame, read_frame
from haptid.live.play import play
from haptid.live.receiver import Receiver
from haptid.live.recorder import Counts, Recorder, SampleRun, recover

__all__ = [
    "Counts",
    "FrameError",
    "LiveAnalysis",
    "LiveSettings",
    "Receiver",
    "Recorder",
    "SampleFrame",
    "SampleRun",
    "analysed_study",
    "pack_frame",
    "play",
    "read_frame",
    "recover",
]

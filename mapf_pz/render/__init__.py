"""Recordings of episodes, and their rendering as text, images, videos and web pages.

It imports the simulator, not the environment. Read `recording.py` first.
"""

from mapf_pz.render.inspection import Inspection
from mapf_pz.render.recording import RecordedViolation, Recording, save_html
from mapf_pz.render.save import save_recording

__all__ = ["Inspection", "RecordedViolation", "Recording", "save_html", "save_recording"]

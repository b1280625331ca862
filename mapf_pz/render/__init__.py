"""Rendering of recordings as images, videos and web pages, and of instances as text, without an environment."""

from mapf_pz.render.recording import Recording
from mapf_pz.render.save import save_recording

__all__ = ["Recording", "save_recording"]

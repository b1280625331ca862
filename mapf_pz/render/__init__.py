"""Rendering of recordings as images, videos and web pages, and of instances as text, without an environment."""

from mapf_pz.render.html import save_html, save_viewer
from mapf_pz.render.recording import RecordedViolation, Recording
from mapf_pz.render.save import save_recording

__all__ = ["RecordedViolation", "Recording", "save_html", "save_recording", "save_viewer"]

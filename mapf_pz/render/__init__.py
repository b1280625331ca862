"""Pictures, films and pages of recordings, and texts of instances; they know no environment."""

from mapf_pz.render.recording import Recording
from mapf_pz.render.save import save_recording

__all__ = ["Recording", "save_recording"]

"""What people look at after a run: the report page and the replay in three dimensions, each one offline file."""

from massprop_drake.display.flight3d import write_replay
from massprop_drake.display.page import write_report

__all__ = ["write_replay", "write_report"]

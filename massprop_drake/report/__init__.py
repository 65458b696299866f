"""What people look at after a run: the report page and the replay in three dimensions, each one offline file."""

from massprop_drake.report.page import write_report
from massprop_drake.report.replay import write_replay

__all__ = ["write_replay", "write_report"]

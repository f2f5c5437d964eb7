"""The files of a real KRC, written from the cell, so that both agree on addresses, channels and limits."""

from deltaq_deploy.krc.files import KrcFile, files_of, write_files
from deltaq_deploy.krc.plan import KrcFilesError, KrcPlan, Start, plan_for

__all__ = ["KrcFile", "KrcFilesError", "KrcPlan", "Start", "files_of", "plan_for", "write_files"]

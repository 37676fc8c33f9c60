"""A run's folder: exclusive access, and replacement of an earlier run as a whole.

A run acts on what it has made itself. Its files are written to a new folder beside NAME, under a
name that nobody can guess. One exchange of names puts it in the place of NAME, or two renames where
the file system has no exchange; the earlier run, every file of which was checked, is removed.
Killed at any moment, a run leaves the earlier files or the new ones, and perhaps a folder
`.srsinv-...`, on which no later run acts; a hint says how to remove it.

A folder that cannot be renamed (the current one, one that is mounted, a sweep's own) takes the
files one by one. Its manifest lists the earlier and the new files until all are there.
"""

from ._claim import RunFolder as RunFolder
from ._claim import check as check
from ._claim import claim as claim
from ._claim import hold as hold
from ._claim import left_by_killed as left_by_killed
from ._manifest import FAILURES as FAILURES
from ._manifest import GATHERED as GATHERED
from ._manifest import MANIFEST as MANIFEST
from ._manifest import METRICS_FILE as METRICS_FILE
from ._manifest import MOST_OF_METRICS as MOST_OF_METRICS
from ._manifest import RunRecord as RunRecord
from ._manifest import described as described
from ._manifest import described_in as described_in
from ._manifest import described_runs as described_runs
from ._manifest import has as has
from ._manifest import listing as listing
from ._manifest import manifest as manifest
from ._manifest import runs_in as runs_in
from ._manifest import strangers as strangers
from ._origin import commit_of as commit_of
from ._place import locate as locate
from ._place import named as named
from ._place import writing as writing

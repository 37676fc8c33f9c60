"""A run's folder: exclusive access, and replacement of an earlier run as a whole.

While a run is at work it has a workspace beside its folder NAME, or inside where nothing can be
beside it:

    .NAME.srsinv/lock   held for as long as the run lives
    .NAME.srsinv/new    its files, as they are written
    .NAME.srsinv/old    the earlier run, to be deleted
    .NAME.srsinv/trash  files being deleted

Two renames, NAME to old and new to NAME, replace the earlier run. Killed between them, a run leaves
no NAME; the next command finds the lock free and moves old back. A folder that cannot be renamed
(the current one, one that is mounted) takes the files one by one, its manifest last: killed
meanwhile, a run leaves `new` with the rest, and the next command moves that in too.
"""

from ._claim import check as check
from ._claim import claim as claim
from ._claim import hold as hold
from ._claim import recover as recover
from ._manifest import MANIFEST as MANIFEST
from ._manifest import described as described
from ._manifest import has as has
from ._manifest import listed as listed
from ._manifest import listing as listing
from ._manifest import manifest as manifest
from ._manifest import strangers as strangers
from ._names import FAILURES as FAILURES
from ._names import GATHERED as GATHERED
from ._names import NEW as NEW
from ._place import locate as locate
from ._place import writing as writing
from ._workspace import Workspace as Workspace

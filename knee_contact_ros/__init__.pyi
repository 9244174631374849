"""Names of the package for type checkers; `__init__.py` imports them on first use."""

from knee_contact_ros.lab.calibrate import calibrate as calibrate
from knee_contact_ros.lab.paired import paired as paired
from knee_contact_ros.lab.sensitivity import sensitivity as sensitivity
from knee_contact_ros.lab.sweep import sweep as sweep
from knee_contact_ros.lab.uncertainty import uncertainty as uncertainty
from knee_contact_ros.offline.gait import Gait as Gait
from knee_contact_ros.offline.load_model import load_model as load_model
from knee_contact_ros.offline.notebooks import estimate_load as estimate_load
from knee_contact_ros.offline.notebooks import solve as solve
from knee_contact_ros.results import Results as Results
from knee_contact_ros.system.errors import UsageError as UsageError

__version__: str

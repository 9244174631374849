"""Function for Python: a model from parameters. It reads no recording, so that an import takes little time."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from ..model.knee import KneeModel
from ..parameters.build import build_model
from ..parameters.curves import curve_texts
from ..parameters.doubts import parameter_doubts
from ..parameters.files import ParameterSource, load_parameters
from ..system.arguments import checked
from ..system.files import DEFAULT_PARAMETERS
from .gait import Gait


@checked
def load_model(
    source: ParameterSource = DEFAULT_PARAMETERS,
    *,
    compiled: bool | None = None,
    curves: Mapping[str, str] = MappingProxyType({}),
) -> KneeModel:
    """Build the model that a parameter file (or several, or mappings) describes. Needs no ROS.

    Without an argument it is the healthy knee. Names have the same meaning as on the command line: a file as given or
    one of the package's own, like `"osteoarthritis"`. Later ones override earlier ones:
    `["osteoarthritis", "mri_femur", {"femur.mass": 8.0}]`.

    The compiled model, a library that is built with the package, computes the same bits about a hundred times faster.
    `compiled` False computes with plain Python. If there is no library and it cannot be built, a warning says so once,
    and the plain model computes.

    `curves` has the contents of files that parameters name, by parameter, instead of the files. Implausible parameters
    (a stiffness or a body weight that must be in other units) cause a warning.

    Raises:
        UsageError: a parameter file cannot be read, a parameter is unknown or not allowed (see `load_parameters`), or a
            profile or a table cannot be used.

    Example:
        >>> from knee_contact_ros import load_model
        >>> load_model(["osteoarthritis", {"femur.mass": 8.0}])
        <KneeModel: circle on plane, hinge, contact law 7.906e+07 N/m^1.5 + 3.112e+09 N/m^1.5, force drive>
    """
    parameters = load_parameters(source)
    plain = build_model(parameters, curves=curve_texts(parameters, curves))
    model = replace(plain, compiled=compiled, results=Gait)
    for doubt in parameter_doubts(parameters, model):
        warnings.warn(doubt, stacklevel=3)  # `checked` lies between
    return model

"""Contact laws by the names that the parameter `contact.law` uses."""

from __future__ import annotations

from collections.abc import Callable

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer
from knee_contact_ros.core.contact_laws.elastic_foundation import elastic_foundation
from knee_contact_ros.core.contact_laws.flores import flores
from knee_contact_ros.core.contact_laws.gonthier import gonthier
from knee_contact_ros.core.contact_laws.hertz import hertz
from knee_contact_ros.core.contact_laws.hunt_crossley import hunt_crossley
from knee_contact_ros.core.contact_laws.kelvin_voigt import kelvin_voigt
from knee_contact_ros.core.contact_laws.lankarani_nikravesh import lankarani_nikravesh
from knee_contact_ros.core.contact_laws.two_layer import two_layer_elastic, two_layer_viscoelastic

CONTACT_LAWS: dict[str, Callable[..., ContactLaw]] = {
    "hertz": hertz,
    "kelvin_voigt": kelvin_voigt,
    "two_layer_elastic": two_layer_elastic,
    "two_layer_viscoelastic": two_layer_viscoelastic,
    "hunt_crossley": hunt_crossley,
    "lankarani_nikravesh": lankarani_nikravesh,
    "flores": flores,
    "gonthier": gonthier,
    "elastic_foundation": elastic_foundation,
}

__all__ = ["CONTACT_LAWS", "ContactLaw", "Layer"]

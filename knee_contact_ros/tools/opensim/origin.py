"""The metadata record of a bag that says from which results of OpenSim it was made."""

from __future__ import annotations

import json
from dataclasses import asdict

from knee_contact_ros import __version__
from knee_contact_ros.offline.gait_files.gait_bag import LEG_QUANTITIES, QUANTITIES, digest
from knee_contact_ros.tools.opensim.opensim_results import Files, KneeGait, Settings


def origin_record(gait: KneeGait, files: Files, settings: Settings, more: dict[str, str]) -> dict[str, str]:
    """What the metadata record says; nothing in it depends on where or when it is written."""
    record = {"package": f"knee_contact_ros {__version__}", "source": "OpenSim results", "side": gait.side}
    for name, path in asdict(files).items():
        if path is not None:
            record |= {name: path.name, f"{name}_sha256": digest(path)}
    record |= {f"column of {what}": name for what, name in gait.columns.items()}
    record |= {"conversions": "\n".join(gait.notes), "settings": json.dumps(asdict(settings)), **QUANTITIES}
    if gait.leg:
        record |= LEG_QUANTITIES
    if gait.body_weight:
        record["body_weight"] = f"{gait.body_weight:.3f} N"
    return record | more

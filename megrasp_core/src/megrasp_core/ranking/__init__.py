"""Ranking: collision with seen and unseen space, contact between the fingers, score
(docs/architecture.md, "Ranking").
"""

from .calibration import (
    FEATURES,
    Calibration,
    fit_calibration,
    logistic_features,
)
from .check import (
    REASONS,
    CheckSettings,
    GraspCheck,
    check_grasps,
    grasp_tilt,
    hits_on_the_way,
    posed,
)
from .contact import Contacts, ContactSettings, ContactSurface, contact_surface, measure_contacts
from .distance_field import DistanceField
from .observation import ObservationSettings, PointState, SceneObservation
from .probe import (
    ClosingPath,
    ClosingVolume,
    GripperProbe,
    ProbeSettings,
    gripper_probe,
)
from .rank import RankSettings, excluded, rejection_counts, score_grasps, suppress_duplicates
from .sweep import SweepSettings, sweep_hits, sweep_points

__all__ = [
    "FEATURES",
    "Calibration",
    "CheckSettings",
    "ClosingPath",
    "ClosingVolume",
    "ContactSettings",
    "ContactSurface",
    "Contacts",
    "DistanceField",
    "GraspCheck",
    "GripperProbe",
    "ObservationSettings",
    "PointState",
    "ProbeSettings",
    "REASONS",
    "RankSettings",
    "SceneObservation",
    "SweepSettings",
    "check_grasps",
    "contact_surface",
    "excluded",
    "fit_calibration",
    "grasp_tilt",
    "gripper_probe",
    "hits_on_the_way",
    "logistic_features",
    "measure_contacts",
    "posed",
    "rejection_counts",
    "score_grasps",
    "suppress_duplicates",
    "sweep_hits",
    "sweep_points",
]

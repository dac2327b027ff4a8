"""What the tracker believes of people and of detectors."""

from __future__ import annotations

from typing import NamedTuple

MAX_UNSEEN_S = 3.0
"""A track not seen for longer is given up, whatever hides it."""


class TrackerSettings(NamedTuple):
    """What a tracker believes of people and of detectors; the defaults are tuned in simulated worlds of training
    (`benchmarks/tracking.py --tune`), the first four by the error of velocities in two training crowds and in
    `dense-ped`. Evidence is in log-odds that a track is a person's who is still there."""

    steady_std: float = 0.1
    """m/s2, how the velocity of who walks on wanders,"""
    turning_std: float = 1.5
    """and that of who turns, starts or stops."""
    turns_per_s: float = 0.3
    """How often people begin to,"""
    steadies_per_s: float = 1.0
    """and how soon they are done."""
    new_speed_std: float = 0.7
    """m/s, of x and of y, of somebody just found."""
    gate: float = 13.8
    """Squared Mahalanobis distance beyond which a detection is not a track's (chi2, 2 d.f.: once in a thousand)."""
    newcomers_per_m2: float = 0.014
    """Detections that belong to no track, in a frame."""
    most_evidence: float = 4.5
    """No more is counted."""
    least_evidence: float = -1.8
    """Below that a track is given up."""
    confirmed: float = 2.0
    """From which a track is surely a person's."""
    gain_bias: float = 0.7
    """That a detection adds to the log-odds of its confidence."""
    least_gain: float = -1.0
    most_gain: float = 1.4
    """That one detection adds: one detector errs alike many times in a row."""
    forgotten_per_s: float = 0.9
    """That a track loses for as long as nobody sees it."""
    most_missed: float = 0.7
    """Of people whom a sensor ought to see, the share of which a single miss convinces."""
    max_unseen_s: float = MAX_UNSEEN_S
    moved_m: float = 0.21
    """How far a track of legs alone must come to be a person's: furniture stands."""
    moving: float = 0.18
    """m/s, how fast it must be."""
    steady: float = 0.8
    """Share of its way that must lead on: what flickers between things goes to and fro."""

"""Contestants by name: agents, filters of the family, or the path of a trained policy."""

from __future__ import annotations

from pathlib import Path

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS
from kfenv.filters.designs import DESIGNS
from kfenv.names import unknown

from .agent import Agent, Contestant, RecordingFilter
from .banks.bank import BankContestant
from .banks.noise_and_motion import ImmRq
from .banks.noise_levels import Imm, Imm8, ImmGlint
from .banks.two_filters import Hmm2q
from .clairvoyant import Clairvoyant, ClairvoyantChannels, ClairvoyantRq
from .family import AdaptiveFamilyFilter, FamilyFilter
from .fixed import Fixed, FixedTuned, Random
from .learned import Learned
from .optimised import Okf
from .pretrained import Pretrained, PretrainedSmall
from .rules.fading import InnovationFading, InnovationFadingPrinted, StrongTracking
from .rules.hidden_markov import HmmNoise, HmmTurn
from .rules.noise import InnovationNoise, PooledNoise, SageHusa, VbNoise
from .rules.robust import Correntropy, HuberGate, NisGate, StudentT
from .rules.satellite_exclusion import Raim, SatelliteGate
from .rules.satellite_hidden_markov import SatelliteHmm

AGENTS: dict[str, type[Agent]] = {
    "fixed": Fixed,
    "fixed-tuned": FixedTuned,
    "innovation-fading": InnovationFading,
    "innovation-fading-printed": InnovationFadingPrinted,
    "strong-tracking": StrongTracking,
    "huber-gate": HuberGate,
    "nis-gate": NisGate,
    "student-t": StudentT,
    "correntropy": Correntropy,
    "sage-husa": SageHusa,
    "vb-noise": VbNoise,
    "innovation-noise": InnovationNoise,
    "pooled-noise": PooledNoise,
    "hmm-noise": HmmNoise,
    "hmm-turn": HmmTurn,
    "satellite-gate": SatelliteGate,
    "raim": Raim,
    "satellite-hmm": SatelliteHmm,
    "clairvoyant": Clairvoyant,
    "clairvoyant-rq": ClairvoyantRq,
    "clairvoyant-channels": ClairvoyantChannels,
    "random": Random,
    "learned": Pretrained,
    "learned-small": PretrainedSmall,
}
BANKS: dict[str, type[BankContestant]] = {
    "imm": Imm,
    "imm-8": Imm8,
    "imm-glint": ImmGlint,
    "imm-rq": ImmRq,
    "hmm-2q": Hmm2q,
}
FILTERS: dict[str, type[RecordingFilter]] = {**BANKS, "okf": Okf}
NAMES = (*AGENTS, *FILTERS, *DESIGNS, *ADAPTIVE_DESIGNS)


def make_agent(name_or_path: str) -> Contestant:
    """The named agent or filter, or the policy at a path (a file, or a training run's folder).

    ``NAME=PATH`` gives a policy a name of its own.

    Raises:
        ValueError: if it is neither a known name nor a readable policy.
    """
    if name_or_path in AGENTS:
        return AGENTS[name_or_path](name_or_path)
    if name_or_path in FILTERS:
        return FILTERS[name_or_path](name_or_path)
    if name_or_path in DESIGNS:
        return FamilyFilter(name_or_path)
    if name_or_path in ADAPTIVE_DESIGNS:
        return AdaptiveFamilyFilter(name_or_path)
    label, _, path = name_or_path.rpartition("=")
    if Path(path).exists():
        return Learned(path, label or None)
    raise ValueError(
        unknown("agent", name_or_path, NAMES) + " A trained agent is named by the path of its "
        "policy.npz or of its folder."
    )

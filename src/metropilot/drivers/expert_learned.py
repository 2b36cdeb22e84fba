"""The learned drivers of Huang25 and those it compares with, each inside the same expert rules."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, final

from metropilot.drivers.expert.policy import AbstractExpertPolicyDriver
from metropilot.drivers.shipped import register_shipped


@final
@register_shipped
class Eitop(AbstractExpertPolicyDriver):
    """EITOE whose change of the rate was learned by PPO.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "eitop"
    summary: ClassVar[str] = "EITOE with the change of the rate learned by PPO"
    source: ClassVar[str] = "Huang25"


@final
@register_shipped
class Itor(AbstractExpertPolicyDriver):
    """Expert rules with one of three changes of the rate, learned by Q-learning in a table.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "itor"
    summary: ClassVar[str] = "Expert rules, discrete changes learned by Q-learning in a table"
    source: ClassVar[str] = "Yin et al. 2014, compared in Huang25"


@final
@register_shipped
class Stod(AbstractExpertPolicyDriver):
    """Expert rules with a continuous change of the rate, learned by DDPG.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "stod"
    summary: ClassVar[str] = "Expert rules, continuous changes learned by DDPG"
    source: ClassVar[str] = "Zhou et al. 2020"


@final
@register_shipped
class Ston(AbstractExpertPolicyDriver):
    """Expert rules with a continuous change of the rate, learned by NAF.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "ston"
    summary: ClassVar[str] = "Expert rules, continuous changes learned by NAF"
    source: ClassVar[str] = "Zhou et al. 2020, compared in Huang25"


EXPERT_POLICIES: Mapping[str, type[AbstractExpertPolicyDriver]] = MappingProxyType(
    {kind.id: kind for kind in (Eitop, Itor, Stod, Ston)}
)
"""Whether shipped or not, by id: each takes an option ``policy``."""

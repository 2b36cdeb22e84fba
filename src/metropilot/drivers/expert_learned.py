"""The learned drivers of Huang25 and those it compares with, each inside the same expert rules."""

from __future__ import annotations

from typing import ClassVar, final

from metropilot.drivers.expert.policy import AbstractExpertPolicyDriver


@final
class Eitop(AbstractExpertPolicyDriver):
    """EITOE whose change of the rate was learned by PPO.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "eitop"


@final
class Itor(AbstractExpertPolicyDriver):
    """Expert rules with one of three changes of the rate, learned by Q-learning in a table.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "itor"


@final
class Stod(AbstractExpertPolicyDriver):
    """Expert rules with a continuous change of the rate, learned by DDPG.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "stod"


@final
class Ston(AbstractExpertPolicyDriver):
    """Expert rules with a continuous change of the rate, learned by NAF.

    Args:
        options: Another policy.
    """

    id: ClassVar[str] = "ston"

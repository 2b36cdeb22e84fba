"""Types of numbers and arrays over NumPy and JAX, for signatures in all packages.

A formula of the plant is written once and runs on Python numbers, NumPy arrays and JAX arrays (see
:mod:`metropilot.physics.arrays`), which have no common base class. jaxtyping therefore looks at shape and
dtype only: ``Float[Array, "nodes"]`` is an array of floats of either library with one axis.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Int, Num, Shaped
else:
    # Annotations are not evaluated unless jaxtyping's import hook is in use, as in the tests; importing
    # jaxtyping for them alone would take a tenth of a second of every command.
    class Shaped:
        """Stand-in for an annotation with a shape."""

        def __class_getitem__(cls, _: object) -> Any:  # noqa: ANN401
            return Any

    Bool = Float = Int = Num = Shaped

Array: TypeAlias = Any
"""An array of NumPy or JAX, or a tracer; give it a shape: ``Float[Array, "nodes 3"]``."""
Scalar: TypeAlias = Any
"""A float of one trainset, 0-d in JAX and a plain number in NumPy; planners pass arrays, elementwise."""
Flag: TypeAlias = Any
"""A truth value, as :data:`Scalar` is a float."""
Index: TypeAlias = Any
"""A whole number, as :data:`Scalar` is a float."""
Key: TypeAlias = Any
"""A random key of ``jax.random``, of shape ()."""

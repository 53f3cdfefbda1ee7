"""The shapes in the signatures of JAX kernels hold: they run with their annotations checked."""

from __future__ import annotations

import subprocess
import sys

CHECKED = """
from jaxtyping import install_import_hook

KERNELS = ["jax_geometry", *(f"pnp.solving.{name}" for name in ("consensus", "damped", "joint", "p3p", "padding"))]
KERNELS += [f"refiners.comparing.{name}" for name in ("align", "render")]
with install_import_hook([f"toolkit.perception.{name}" for name in KERNELS], "beartype.beartype"):
    import toolkit.perception.pnp.jax_joint
    import toolkit.perception.pnp.jax_ransac
    import toolkit.perception.refiners.render_compare
import jax.numpy as jnp
from jaxtyping import TypeCheckError

from toolkit.perception.jax_geometry import skew
from toolkit.plugin_kit.conformance import pnp
from toolkit.plugin_kit.conformance.kit import Subject
from toolkit.plugin_kit.conformance.scene import refine_task
from toolkit.stages import PNP, REFINERS
from toolkit.types import PnPSolution, Refined

try:
    skew(jnp.zeros(4))
except TypeCheckError:
    pass
else:
    raise SystemExit("nothing is checked")
problem = pnp._problem()
for name, settings in (("jax_ransac", {}), ("jax_joint", {}), ("jax_joint", {"prior": "none"})):
    assert isinstance(PNP.create(name, settings).solve(problem, 0), PnPSolution), name
for prior in ("planar", "resting", "none"):
    settings = {"prior": prior, "yaws": 12, "rests": 2}
    assert isinstance(REFINERS.create("render_compare", settings).refine(refine_task(1)), Refined), prior
"""


def test_every_kernel_is_given_and_gives_the_shapes_it_states():
    done = subprocess.run([sys.executable, "-P", "-c", CHECKED], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr or done.stdout

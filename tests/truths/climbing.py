"""A small nonlinear structure with all that makes exports difficult: tables, trims, delays."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from casid import NonlinearModel, Record, Scalar, parameter, spline
from casid.free import Free
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.sensitivity import Point

DT, N = 0.04, 60
X0 = np.array([31.0, 0.05, 0.02])


class Climbing(NonlinearModel):
    """Speed and pitch under stick and throttle, damping from a table over speed."""

    states, inputs, outputs = ("V", "q", "theta"), ("lon", "throttle"), ("q", "V", "az")
    units: ClassVar[Mapping[str, str]] = MappingProxyType({"V": "m/s", "throttle": "-"})

    Mq: Scalar = parameter(default=-1.8, unit="1/s")
    Mlon: Scalar = parameter(default=9.0, unit="rad/s^2")
    drag: Scalar = parameter(default=0.004, unit="1/m")
    tau: Scalar = parameter(default=0.07, lower=0.0, upper=0.3, unit="s")

    def reference(self) -> Mapping[str, Scalar]:
        return {"V": 30.0, "throttle": 3.6 / 8.2}

    def derivatives(self, x: Any, u: Any) -> Sequence[Scalar]:
        damping = self.Mq * spline(x.V, (20.0, 30.0, 45.0), (0.7, 1.0, 1.4))
        pull = 8.2 * u.throttle - self.drag * x.V**2
        return [
            pull - 9.80665 * ca.sin(x.theta),
            damping * x.q + self.Mlon * u.lon * (x.V / 30) ** 2 - 0.4 * ca.tanh(x.theta),
            x.q,
        ]

    def measurements(self, x: Any, u: Any) -> Sequence[Scalar]:
        return [x.q, x.V, -9.80665 * ca.cos(x.theta) - x.V * x.q + 2.0 * u.lon]

    def delays(self) -> Mapping[str, Scalar]:
        return {"lon": self.tau}


AIRCRAFT = Climbing()


def commands():
    """Total inputs (N, 2) that move by steps."""
    levels = np.random.default_rng(3).uniform(-0.05, 0.05, (N // 6, 2))
    return np.repeat(levels, 6, axis=0) + np.array([0.0, 0.5])


def by_casid(model, u, hold, count):
    """Outputs (N, 3) from X0 by output error's integration, so many steps a sample."""
    record = Record(DT * np.arange(N), u, np.zeros((N, 3)), model.inputs, model.outputs, hold=hold)
    n = len(model.vector())
    free = Free(model, np.arange(n), np.full(n, -np.inf), np.full(n, np.inf), np.ones(n))
    evaluator = NonlinearEvaluator(free, lay_out([record], 1e9), count)
    point = Point(lam=model.vector(), bias=np.zeros((1, 3)), nodes=X0[None])
    return evaluator.simulate(point).residuals

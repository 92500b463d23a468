"""A decay that an input drives, as a linear and as a nonlinear structure."""

from casid import Model, NonlinearModel, Rows, Scalar, parameter

A = -0.5  # 1/s


class Decay(Model):
    """x' = a x + u."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a: Scalar = parameter(default=A, lower=-5.0, upper=5.0, unit="1/s")

    def A(self) -> Rows:
        return [[self.a]]

    def B(self) -> Rows:
        return [[1.0]]


class Plain(NonlinearModel):
    """The same, in total values."""

    states, inputs, outputs = Decay.states, Decay.inputs, Decay.outputs
    a: Scalar = parameter(default=A, lower=-5.0, upper=5.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.a * x.x + u.u]

    def measurements(self, x, u):  # noqa: ARG002
        return [x.x]

"""An aircraft with two trims at one speed, which its outputs hardly tell apart."""

from casid import NonlinearModel, Scalar, parameter


class Twofold(NonlinearModel):
    """V' = d (10 - V) + e - 1, w' = a (w² - 1) + e - 1: at V = 10, e = 1 it balances at w = ±1.

    Nothing measures w.
    """

    states, inputs, outputs = ("V", "w"), ("e",), ("V", "az")

    a: Scalar = parameter(default=0.4, lower=0.01, upper=3.0, unit="1/m")
    d: Scalar = parameter(default=0.7, lower=0.01, upper=9.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.d * (10.0 - x.V) + u.e - 1.0, self.a * (x.w**2 - 1.0) + u.e - 1.0]

    def measurements(self, x, u):
        return [x.V, self.a * (x.w**2 - 1.0) + u.e - 1.0]

    def reference(self):
        return {"V": 10.0, "w": 0.2, "e": 1.0}

"""Short-period motion: pitch rate and heave after a longitudinal input, speed and attitude steady.

Two degrees of freedom, G. D. Padfield, Helicopter Flight Dynamics, 2nd ed., section 4.3.3, and
R. V. Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 4. The approximation holds
from about 1 rad/s up, where the phugoid has gone, to about 8 rad/s, where the rotor's flapping
begins to matter and the delay stands for it.

    w' = Zw w + (U0 + Zq) q + Zlon lon(t - tau)        az = Zw w + Zq q + Zlon lon(t - tau)
    q' = Mw w + Mq q + Mlon lon(t - tau)

What identifies it: doublets or 3-2-1-1 of the longitudinal stick of a few seconds, each its own
record (detrended by its first samples), with az and q. Zq is told from the flight speed only by
az; with pitch rate alone Zw, Mw and Zlon appear in products and must be fixed in part
(`identifiability` says which). Sticks as a fraction of full travel.
"""

from collections.abc import Mapping

from casid import Model, Rows, Scalar, parameter


class ShortPeriod(Model):
    """Derivatives of the specific force Z and of the pitch acceleration M."""

    states = ("w", "q")
    inputs = ("lon",)
    outputs = ("az", "q")

    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Zq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Mw: Scalar = parameter(default=-0.01, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mq: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")

    Zlon: Scalar = parameter(default=-20.0, lower=-200.0, upper=200.0, unit="m/s^2")
    Mlon: Scalar = parameter(default=8.0, lower=-30.0, upper=30.0, unit="rad/s^2")

    tau_lon: Scalar = parameter(default=0.08, lower=0.0, upper=0.25, unit="s")

    U0: float = 41.15  # flight speed [m/s]; never estimated

    def A(self) -> Rows:
        return [
            [self.Zw, self.Zq + self.U0],
            [self.Mw, self.Mq],
        ]

    def B(self) -> Rows:
        return [[self.Zlon], [self.Mlon]]

    def C(self) -> Rows:
        return [
            [self.Zw, self.Zq],
            [0, 1],
        ]

    def D(self) -> Rows:
        return [[self.Zlon], [0]]

    def delays(self) -> Mapping[str, Scalar]:
        return {"lon": self.tau_lon}

"""Vertical response to collective with coning and dynamic inflow.

The acceleration after a collective step overshoots while the inflow builds up and the blades cone,
which a heave model with one derivative cannot follow: R. T. N. Chen, W. S. Hindson, Influence of
Dynamic Inflow on the Helicopter Vertical Response, NASA TM-88327, 1986; as an identified structure
M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 15.
Blade-element thrust and flapping moment of a rigid, untwisted, centrally hinged blade, inflow nu
uniform (down), climb and forward speed small:

    T/m  = -Zw ((2/3) R (Omega theta - b0') + w - nu)          thrust, theta = gearing col
    b0'' = -(nu_b Omega)^2 b0 + damping (Omega theta - b0' + (4/3) (w - nu) / R) + c w'
    nu'  = gain T/m + inflow (w / 2 - nu)                      apparent mass, momentum theory
    w'   = -T/m + mu b0''                                      reaction of the blades at the hub

with damping = gamma Omega / 8 of the Lock number. Rotor speed, radius and the blades' mass ratios
are plain fields: they are known, and cannot be told from az.

What identifies it: a collective sweep or doublets rich in 1-15 rad/s, in hover or slow flight, with
az at the centre of gravity: nothing turns here, so a sensor elsewhere has no place in it
(`models/sensors.py`); what the aircraft's turns add to it, -x q' in the first place, is to be taken
out of the records. Gearing, Zw, damping and the two inflow parameters are then told apart;
w measured beside az (Doppler, differentiated height) sharpens Zw.
"""

from collections.abc import Mapping

from casid import Model, Rows, Scalar, parameter


class HeaveInflow(Model):
    """One vertical, one coning and one inflow degree of freedom."""

    states = ("w", "nu", "b0", "b0_dot")
    inputs = ("col",)
    outputs = ("az",)

    Zw: Scalar = parameter(default=-1.0, lower=-4.0, upper=-0.1, unit="1/s")
    gearing: Scalar = parameter(default=0.25, lower=0.02, upper=1.0, unit="rad")
    damping: Scalar = parameter(default=25.0, lower=3.0, upper=100.0, unit="1/s")
    gain: Scalar = parameter(default=6.0, lower=0.5, upper=50.0, unit="-")
    inflow: Scalar = parameter(default=6.0, lower=0.5, upper=50.0, unit="1/s")
    tau_col: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")

    Omega: float = 27.0  # rotor speed [rad/s]
    R: float = 8.18  # radius [m]
    nu_b: float = 1.04  # flap frequency over rotor speed
    c: float = 0.188  # blade: first over second moment of mass [1/m]
    mu: float = 0.21  # first moments of all blades over the aircraft's mass [m]

    def accelerations(self) -> tuple[list[Scalar], list[Scalar]]:
        """Rows of w' and b0'' over (w, nu, b0, b0', col), the hub's coupling solved for."""
        Zw, d, R, Omega = self.Zw, self.damping, self.R, self.Omega
        air: list[Scalar] = [1, -1, 0, -2 / 3 * R, 2 / 3 * Omega * R * self.gearing]
        lift = [Zw * entry for entry in air]
        flap = [
            4 / 3 * d / R,
            -4 / 3 * d / R,
            -((self.nu_b * Omega) ** 2),
            -d,
            d * Omega * self.gearing,
        ]
        both = 1 - self.c * self.mu
        heave = [(a + self.mu * b) / both for a, b in zip(lift, flap, strict=True)]
        coning = [(b + self.c * a) / both for a, b in zip(lift, flap, strict=True)]
        return heave, coning

    def A(self) -> Rows:
        heave, coning = self.accelerations()
        Zw, gain, R = self.Zw, self.gain, self.R
        return [
            heave[:4],
            [self.inflow / 2 - gain * Zw, gain * Zw - self.inflow, 0, 2 / 3 * R * gain * Zw],
            [0, 0, 0, 1],
            coning[:4],
        ]

    def B(self) -> Rows:
        heave, coning = self.accelerations()
        thrust = -2 / 3 * self.Omega * self.R * self.gearing * self.Zw
        return [[heave[4]], [self.gain * thrust], [0], [coning[4]]]

    def C(self) -> Rows:
        return [self.accelerations()[0][:4]]

    def D(self) -> Rows:
        return [[self.accelerations()[0][4]]]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col}

"""A multirotor near hover: rigid body with rotor drag, behind the motors' lag and one delay.

After W. Wei, M. B. Tischler, K. Cohen, "System identification and controller optimization of a
quadrotor unmanned aerial vehicle in hover", J. American Helicopter Society 62(4), 2017: the axes of
a symmetric multirotor decouple, the speed derivatives Xu, Yv, Mu and Lv come from the rotors' drag
and flapping, and a first-order lag holds motors and their controllers.

Inputs are motor commands mixed into thrust and three moments, positive for climb, right roll, nose
up and right yaw. Every command is followed by d' = (command - d) / T_motor after the delay. A
change of motor speed turns the airframe too: r' = Nr r + Nyaw d + Nacc (command - d).

What identifies it: rates above 1 Hz give Lroll, Mpitch, lag and delay; attitudes and velocities
below give Xu, Yv, Lv and Mu. The rates' own damping, Lp and Mq, is small beside what Lv and Mu make
of velocity, and records flown by a controller hardly tell it.
"""

from collections.abc import Mapping

from casid import Model, Rows, Scalar, parameter


class Multirotor(Model):
    """Hovering multirotor with three body velocities, rates and attitudes; see the module."""

    states = (
        *("u", "v", "w", "p", "q", "r", "phi", "theta"),
        *("d_thrust", "d_roll", "d_pitch", "d_yaw"),
    )
    inputs = ("thrust", "roll", "pitch", "yaw")
    outputs = ("az", "u", "v", "p", "q", "r", "phi", "theta")

    Xu: Scalar = parameter(default=-0.3, lower=-3.0, upper=0.0, unit="1/s")
    Yv: Scalar = parameter(default=-0.3, lower=-3.0, upper=0.0, unit="1/s")
    Zw: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")
    Lv: Scalar = parameter(default=-0.2, lower=-40.0, upper=5.0, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-1.0, lower=-20.0, upper=0.0, unit="1/s")
    Mu: Scalar = parameter(default=0.2, lower=-5.0, upper=40.0, unit="rad/(m s)")
    Mq: Scalar = parameter(default=-1.0, lower=-20.0, upper=0.0, unit="1/s")
    Nr: Scalar = parameter(default=-0.5, lower=-20.0, upper=0.0, unit="1/s")

    Zthrust: Scalar = parameter(default=-15.0, lower=-100.0, upper=0.0, unit="m/s^2")
    Lroll: Scalar = parameter(default=300.0, lower=0.0, upper=3000.0, unit="rad/s^2")
    Mpitch: Scalar = parameter(default=300.0, lower=0.0, upper=3000.0, unit="rad/s^2")
    Nyaw: Scalar = parameter(default=20.0, lower=0.0, upper=1000.0, unit="rad/s^2")
    Nacc: Scalar = parameter(default=50.0, lower=-1000.0, upper=1000.0, unit="rad/s^2")

    T_motor: Scalar = parameter(default=0.05, lower=0.01, upper=0.3, unit="s")
    tau: Scalar = parameter(default=0.02, lower=0.0, upper=0.1, unit="s")

    g: float = 9.80665

    def A(self) -> Rows:
        s, rate = self, 1 / self.T_motor
        return [
            [s.Xu, 0, 0, 0, 0, 0, 0, -s.g, 0, 0, 0, 0],
            [0, s.Yv, 0, 0, 0, 0, s.g, 0, 0, 0, 0, 0],
            [0, 0, s.Zw, 0, 0, 0, 0, 0, s.Zthrust, 0, 0, 0],
            [0, s.Lv, 0, s.Lp, 0, 0, 0, 0, 0, s.Lroll, 0, 0],
            [s.Mu, 0, 0, 0, s.Mq, 0, 0, 0, 0, 0, s.Mpitch, 0],
            [0, 0, 0, 0, 0, s.Nr, 0, 0, 0, 0, 0, s.Nyaw - s.Nacc],
            [0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0],
            *([-rate if j == 8 + i else 0 for j in range(12)] for i in range(4)),
        ]

    def B(self) -> Rows:
        rate = 1 / self.T_motor
        return [
            *[[0] * 4] * 5,
            [0, 0, 0, self.Nacc],
            *[[0] * 4] * 2,
            *([rate if j == i else 0 for j in range(4)] for i in range(4)),
        ]

    def C(self) -> Rows:
        return [
            [0, 0, self.Zw, 0, 0, 0, 0, 0, self.Zthrust, 0, 0, 0],
            *([float(i == j) for j in range(12)] for i in (0, 1, 3, 4, 5, 6, 7)),
        ]

    def delays(self) -> Mapping[str, Scalar]:
        return dict.fromkeys(self.inputs, self.tau)

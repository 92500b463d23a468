"""Nonlinear structures in words."""

from truths.swing import Swing

from casid.nonlinear.words import equations_text
from casid.structure.overview import describe

EQUATIONS = """\
equations, total values
  dq/dt = (((Mq*q)-(M*sin(theta)))+((Mlon*cos(theta))*lon))
  dtheta/dt = q
  q measured = q
  theta measured = theta

reference condition, where the linearisation below holds
  q = 0 rad/s, d/dt 0
  theta = 0 rad, d/dt 0
  lon = 0"""


def test_equations_are_told_with_the_names_of_the_file():
    assert equations_text(Swing()) == EQUATIONS


def test_check_tells_equations_and_linearisation():
    text = str(describe(Swing()))
    assert EQUATIONS in text
    assert "A at the guess" in text
    told = "one 3-2-1-1 a control, of the linearisation at the reference condition alone"
    assert f"identifiability from {told}\n  rank 4 of 4" in text

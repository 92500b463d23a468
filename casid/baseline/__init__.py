"""The frequency domain alone: derivatives, equivalent systems and handling qualities."""

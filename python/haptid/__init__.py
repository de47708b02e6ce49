"""haptid: dynamic models of haptic devices and robots from their own motion logs."""

"""Loop closure: positions and rates of the passive joints as functions of the active ones."""

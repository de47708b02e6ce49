"""How a motion becomes rows of y = W beta + rho, and their R factors.

May use device, log, dynamics and motion; contains no estimate.
"""

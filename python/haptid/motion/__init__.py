"""How a log becomes a motion: treatment, filters, time shift, and joint-side channels.

May use device and log.
"""

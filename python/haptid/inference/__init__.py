"""Statistical inference from estimates: targets, comparison, drift, elimination, drive gains, payloads, diagnosis.

May import estimation, validation and all before them; it reads no files and knows no study.
"""

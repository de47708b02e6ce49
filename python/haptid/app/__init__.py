"""The workbench: haptid's files and commands as pages of a browser, served on this machine only.

Files of a folder are the truth; the browser keeps nothing. Needs the extra `haptid[app]`. May import everything but the
command line. Nothing heavy is imported before a page asks for it.
"""

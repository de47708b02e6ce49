# The same commands as in CI. Each sets up what it needs; nothing is installed by hand.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# With the extras of each target. uv needs a tenth of pip's time; pip does it where uv cannot (no wheel for the platform,
# an index that only pip is told of).
INSTALL = $(PIP) install -c constraints.txt uv && \
	$(BIN)/uv pip install --quiet --python $(VENV) -c constraints.txt -e ".[$(EXTRAS)]" || \
	$(PIP) install -c constraints.txt -e ".[$(EXTRAS)]"
RUST := $(shell find crates -name "*.rs" -o -name Cargo.toml) Cargo.toml Cargo.lock
# One BLAS thread: the matrices are small, and the core has threads of its own.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Some tests start many processes; each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-fast test-lowest check miri bench bench-quick fuzz sbom hashes install-hashed docs wheel wheel-linux clean

demo: $(VENV)/.run
	$(BIN)/python examples/demo.py --out demo

# A worker for each processor of the system; tests go to whichever is free, so that no long file holds the others up.
TESTED := $(BIN)/python -m pytest -n logical --dist worksteal

test: $(VENV)/.test
	$(TESTED)

# The most telling ones: laws, published results, recordings, errors, recovery of known parameters, what is read.
FAST := identity golden real errors recovery/test_known_parameters.py recovery/test_constrained_estimates.py \
	unit/test_core_*.py unit/test_device_*.py unit/test_log_*.py

test-fast: $(VENV)/.test
	$(TESTED) $(wildcard $(FAST:%=tests/%))

# The fast tests with the lowest versions that pyproject.toml allows. Warnings of old libraries about new ones are no errors.
test-lowest: $(VENV)/.run
	$(PIP) install -c constraints.txt uv
	$(BIN)/uv venv --quiet --clear $(VENV)-lowest
	$(BIN)/uv pip compile --quiet --resolution lowest-direct --extra test pyproject.toml -o $(VENV)-lowest/versions.txt
	$(BIN)/uv pip install --quiet --python $(VENV)-lowest -r $(VENV)-lowest/versions.txt
	PYTHONPATH=python $(VENV)-lowest/bin/python -m pytest -n logical --dist worksteal -o filterwarnings= $(wildcard $(FAST:%=tests/%))

# The bindings have no Rust tests: they are built with the package, linted here, and called by the tests in Python.
check: $(VENV)/.test
	cargo fmt --all --check
	cargo clippy --locked --all-targets --quiet -- -D warnings
	cargo test --locked --release -p haptid-core
	$(BIN)/python tools/check_rust_layers.py
	$(BIN)/python tools/check_public_names.py
	$(BIN)/python tools/check_scripts.py
	$(BIN)/python tools/write_sbom.py --check
	$(BIN)/lint-imports --no-logo
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(MAKE) --no-print-directory docs

# Undefined behaviour of the core, as far as one process without vector instructions shows it: Miri runs the laws and the
# tests of buffers on the portable back end. It needs a nightly toolchain: `rustup toolchain install nightly` and
# `rustup component add --toolchain nightly miri rust-src`.
MIRI := MIRIFLAGS="-Zmiri-disable-isolation -Zmiri-tree-borrows" PROPTEST_CASES=1 cargo +nightly miri test --locked -p haptid-core
miri:
	$(MIRI) --test laws
	$(MIRI) --lib -- no_pointer merging least_squares orientation

bench: $(VENV)/.test $(VENV)-bench/.made
	$(BIN)/python benchmarks/run.py

# Ratios to NumPy's times in the same run, beside the recorded ones; names what is slower by more than 10 %.
bench-quick: $(VENV)/.run
	RAYON_NUM_THREADS=1 $(BIN)/python benchmarks/quick.py

# All readers of files, and the core's argument checks, on mutations of fuzz/seeds; findings go to fuzz/findings.
MINUTES ?= 5
fuzz: $(VENV)/.test
	$(BIN)/python -m fuzz.run --minutes $(MINUTES)

# What a build contains: components of the environment and crates with versions and licences, as CycloneDX.
sbom: $(VENV)/.run
	$(BIN)/python tools/write_sbom.py dist/haptid.cdx.json

# SHA-256 of every file that pip may install for haptid[all] and its build, without addresses, at the versions of
# constraints.txt; `make install-hashed` into a fresh environment refuses any other file.
hashes: $(VENV)/.made
	$(PIP) install -c constraints.txt uv
	echo maturin | $(BIN)/uv pip compile --quiet --universal --generate-hashes --no-annotate --no-header \
		--no-emit-index-url -c constraints.txt --extra all pyproject.toml - -o hashes.txt

install-hashed: $(VENV)/.made
	$(PIP) install --require-hashes -r hashes.txt
	$(PIP) install --no-deps --no-build-isolation -e .

# The site, without warnings; then its links, anchors, formulas, and its width on a phone.
docs: $(VENV)/.test
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	$(BIN)/python tools/site/check.py

wheel: $(VENV)/.run
	$(PIP) install -c constraints.txt maturin
	$(BIN)/maturin build --release --locked --out dist
	$(BIN)/python tools/write_sbom.py dist/haptid.cdx.json

# For every Linux since glibc 2.17, whatever this one is: zig links against the old library. The sources beside it.
wheel-linux: $(VENV)/.run
	$(PIP) install -c constraints.txt maturin ziglang
	$(BIN)/maturin sdist --out dist
	PATH=$(CURDIR)/$(BIN):$$PATH $(BIN)/maturin build --release --locked --compatibility manylinux2014 --zig --out dist

clean:
	rm -rf $(VENV) target demo site dist

$(VENV)/.made:
	$(PYTHON) -c "import sys; sys.exit(0 if sys.version_info >= (3, 11) else 'haptid needs Python 3.11 or newer')"
	$(PYTHON) -m venv $(VENV)
	touch $@

# The extension is built by maturin, in release mode, with the locked crates.
$(VENV)/.run: EXTRAS := all
$(VENV)/.run: $(VENV)/.made pyproject.toml constraints.txt $(RUST)
	$(INSTALL)
	touch $@

$(VENV)/.test: EXTRAS := test,oracle,lint,docs
$(VENV)/.test: $(VENV)/.run
	$(INSTALL)
	touch $@

# Programs that haptid is measured against, in an environment of their own; CasADi's C code needs gcc beside it, and
# Pinocchio's headers g++ and some minutes. Without them these two are left out.
PEERS := $(VENV)-bench/$(notdir $(BIN))/python
$(VENV)-bench/.made: benchmarks/peers/requirements.txt benchmarks/peers/pinocchio_loop.cpp
	$(PYTHON) -m venv $(VENV)-bench
	$(PEERS) -m pip --disable-pip-version-check --quiet install -r $<
	-cd benchmarks && ../$(PEERS) -m peers.pinocchio_cpp
	touch $@

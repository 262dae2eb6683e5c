# `make` lists every target. Each target sets up what it needs.

VENV ?= .venv
BIN := $(VENV)/bin
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
# Stamps of the set-up: the module with the packages of the commands, those of `make test`, and all others.
MODULE := $(VENV)/.module
TESTING := $(VENV)/.testing
PACKAGES := $(VENV)/.packages
RUST_SOURCES := Cargo.toml Cargo.lock $(shell find rust -name '*.rs' -o -name Cargo.toml)
# Flights of `make demo`: in 18 m/s from ahead, and an arm engine that stops; and how they are filmed.
GALE := test1_gale test2_gale test1_observer_gale robot_gale
ENGINE := test2_arm_engine_out robot_arm_engine_out
GALE_FILM := --camera side --start 4 --end 31 --speed 3
ENGINE_FILM := --start 27 --speed 1.5

# Duration of `make fuzz`.
MINUTES ?= 60

# Folder to which the Rust tests write their measurements, for pytest's summary.
MEASURED := $(abspath target/measured)

# Test processes of up to 2.5 GB each, for two cores: many tests wait for a browser or for subprocesses. An idle one
# takes tests from the end of another's list. They share the cores: XLA's threads (NPROC) would only contend.
WORKERS ?= 3
PARALLEL := --numprocesses $(WORKERS) --dist worksteal
ONE_THREAD := NPROC=1

# XLA's compilation cache, shared by the test processes and kept for their next run.
JAX_CACHE := JAX_COMPILATION_CACHE_DIR="$(abspath target/jax)" JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0 \
	JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES=-1

# Tests start hundreds of processes: Python keeps the modules that it has compiled, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

# Compilation takes most of the time of JAX's tests; XLA's lowest optimisation level, and functions compiled in one piece
# instead of many in parallel, halve it. `make portability` runs the numerical ones with full optimisation.
LEAST_OPTIMISED := XLA_FLAGS="--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false \
	--xla_cpu_parallel_codegen_split_count=1"

# Folders of `make test`, and the others. Pinocchio, one of the independent implementations, needs 400 MB.
CORE := tests/golden tests/parity tests/gradients tests/references
PINOCCHIO := tests/parity/test_dynamics_pinocchio.py
# Shipped files with everything that can be done with them: each once in `make test`.
EACH := tests/matrix/test_each.py
OTHERS := $(filter-out $(CORE) tests/matrix tests/__pycache__,$(patsubst %/,%,$(wildcard tests/*/))) $(PINOCCHIO)
PYTEST = MEASURED="$(MEASURED)" $(JAX_CACHE) $(ONE_THREAD) $(LEAST_OPTIMISED) $(BIN)/python -m pytest $(PARALLEL)

# Emulation of another processor: no AVX in the C library's functions, in what XLA compiles, in OpenBLAS or in NumPy.
OTHER_PROCESSOR = $(JAX_CACHE) GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX512VL,-AVX512DQ \
	XLA_FLAGS=--xla_cpu_max_isa=SSE4_2 OPENBLAS_CORETYPE=Nehalem NPY_DISABLE_CPU_FEATURES="$(NUMPY_FEATURES)"
NUMPY_FEATURES = $(shell $(BIN)/python -c 'import numpy; \
	print(*numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", []))')
# A file of these stays in one process, since its tests share thousands of drawn problems.
NUMERICAL := $(if $(QUICK),tests/parity/test_jax_qp_box.py tests/parity/test_aero.py, \
	tests/parity tests/gradients tests/units tests/train)

# Other machines whose bits `make bits` compares: cross compiler and emulator of each; and what it flies: force models,
# observer, sensors, plan. Windows needs wine 9 or newer.
ARM := aarch64-unknown-linux-gnu
WINDOWS := x86_64-pc-windows-gnu
BITS_TOOLS := aarch64-linux-gnu-gcc qemu-aarch64 x86_64-w64-mingw32-gcc wine
run-$(ARM) := qemu-aarch64 -L /usr/aarch64-linux-gnu
run-$(WINDOWS) := WINEDEBUG=-all wine
BITS := $(patsubst %,configs/experiments/%.toml,test1 test2 test4 test1_published_observer test2_sensors test2_mpc)
BITS_PROGRAM := --locked --quiet --release --package flight-sim --no-default-features --example bits

# Machines of `make wheels`. Those for the last two have no Clarabel, whose crate is a library of its own besides. Windows is
# linked by mingw: maturin (1.16) tells zig to export a module by its name with the package.
LINUX := x86_64-unknown-linux-gnu
WHEELS := $(LINUX) $(ARM) aarch64-apple-darwin $(WINDOWS)
wheel-$(LINUX) := --zig --compatibility manylinux2014
wheel-$(ARM) := $(wheel-$(LINUX))
wheel-aarch64-apple-darwin := --zig --no-default-features
wheel-$(WINDOWS) := --no-default-features

# The flight lab: a page that flies in a browser. Vector instructions that every browser has since 2023.
LAB := target/lab
LAB_PAGE := rust/lab/page
LAB_WASM := target/wasm32-unknown-unknown/release/flight_lab.wasm

BUILD_WHEEL = $(BIN)/maturin build --release --locked --quiet --compression-level 9 --out dist

# Films flights side by side: their names, options, the name of the film.
film = $(BIN)/jax-aero view video $(firstword $(1)) --beside $(wordlist 2,$(words $(1)),$(1)) $(2) --fps 10 --size 960x480 \
	--renderer pillow --out results/figures/$(3).webp --overwrite

# Refuses where one of Rust's targets is not installed.
need-targets = @for target in $(1); do rustc --print target-libdir --target $$target | xargs test -d || \
	{ echo "Rust's target is missing: rustup target add $$target"; exit 1; }; done

# `make install-capi`: where to, and the folder of the library, which is built if none is given.
PREFIX ?= /usr/local
INSTALLED := $(DESTDIR)$(PREFIX)
LIBFLIGHT ?=
VERSION = $(shell sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml)

# One interpreter for every build of the bindings, so that cargo does not build them again for another.
export PYO3_PYTHON := $(abspath $(BIN)/python)

.DEFAULT_GOAL := help
.PHONY: help setup demo view test test-all fuzz audit lint lint-rust lint-python bench figures reproduce generated verify docs lab clean portability bits wheel wheels install-capi
.DELETE_ON_ERROR:

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(PACKAGES) ## create .venv, compile the Rust module, install all pinned packages

demo: $(MODULE) ## fly four controllers in 18 m/s from ahead, and two whose arm engine stops: table, figure, two films
	@echo "six flights, a figure and two films (a minute)"
	$(BIN)/jax-aero fly $(GALE) $(ENGINE) --overwrite
	$(BIN)/jax-aero figures demo
	$(call film,$(GALE),$(GALE_FILM),flight)
	$(call film,$(ENGINE),$(ENGINE_FILM),engine_out)

view: $(MODULE) lab ## fly in the browser: drag the wind until the robot falls
	$(BIN)/jax-aero view

# Rust's tests compile beside the set-up, which waits for the network and for single crates, and stop with it. (Not
# `$(MAKE)`: `make -n` would compile.)
test: ## test the crate, and its agreement with JAX, CasADi and MuJoCo
	@trap 'kill $$! 2>/dev/null' EXIT; trap 'exit 130' INT TERM; \
	nice -n 19 cargo test --locked --no-run & $${MAKE:-make} --no-print-directory $(TESTING) && wait $$!
	rm -rf "$(MEASURED)"
	MEASURED="$(MEASURED)" cargo test --locked
	$(PYTEST) $(CORE) $(EACH) --ignore=$(PINOCCHIO)

test-all: test $(PACKAGES) ## run every test: commands, studies, viewer, training, documents too
	$(PYTEST) $(OTHERS) $(filter-out $(EACH),$(wildcard tests/matrix/test_*.py))

portability: $(TESTING) ## run the numerical tests as another processor would, on one core and on two (QUICK=1: a minute)
	$(if $(QUICK),,$(OTHER_PROCESSOR) cargo test --locked)
	$(if $(QUICK),,$(OTHER_PROCESSOR) taskset --cpu-list 0 $(BIN)/python -m pytest -q $(NUMERICAL))
	$(OTHER_PROCESSOR) taskset --cpu-list 0,1 $(BIN)/python -m pytest -q $(PARALLEL) --dist loadfile $(NUMERICAL)
	$(if $(QUICK),,$(MAKE) bits)

bits: ## fly six experiments of 20 s here and, in emulation, as 64-bit ARM and Windows, and compare every recorded bit
	@for tool in $(BITS_TOOLS); do command -v $$tool >/dev/null || \
		{ echo "$$tool is missing: apt-get install gcc-aarch64-linux-gnu qemu-user gcc-mingw-w64-x86-64 wine"; exit 1; }; done
	$(call need-targets,$(ARM) $(WINDOWS))
	cargo build $(BITS_PROGRAM)
	target/release/examples/bits 20 $(BITS) > target/bits.here
	$(foreach other,$(ARM) $(WINDOWS),CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
		cargo build $(BITS_PROGRAM) --target $(other) && \
		$(run-$(other)) target/$(other)/release/examples/bits$(if $(findstring windows,$(other)),.exe) 20 $(BITS) > target/bits.$(other) && \
		diff target/bits.here target/bits.$(other) && ) true
	@echo "the same bits in all $$(wc -l < target/bits.here) signals of $(words $(BITS)) flights"

wheel: $(PACKAGES) ## build wheel and source package into dist/, and fly with the wheel alone in an empty environment
	@$(MAKE) --no-print-directory lab || echo "the wheel will lack the page of \`jax-aero view\`"
	rm -rf dist
	$(BIN)/maturin sdist --out dist
	$(BUILD_WHEEL)
	$(BIN)/python tests/tools/wheel.py dist/*.whl

wheels: $(PACKAGES) lab ## build wheels for Linux (x86-64, 64-bit ARM), macOS (zig) and Windows (mingw) into dist/, and fly with the first
	@PATH="$(abspath $(BIN)):$$PATH"; command -v zig >/dev/null || python3 -c "import ziglang" 2>/dev/null || \
		{ echo "zig is missing: $(BIN)/pip install ziglang (100 MB), or https://ziglang.org"; exit 1; }
	@command -v x86_64-w64-mingw32-gcc >/dev/null || { echo "mingw is missing: apt-get install gcc-mingw-w64-x86-64"; exit 1; }
	$(call need-targets,$(WHEELS))
	rm -rf dist
	$(foreach target,$(WHEELS),PATH="$(abspath $(BIN)):$$PATH" $(BUILD_WHEEL) --target $(target) $(wheel-$(target)) && ) true
	$(BIN)/python tests/tools/wheel.py dist/*.whl

install-capi: ## install libflight for C and C++: header, libraries, files for pkg-config and CMake (PREFIX=/usr/local)
	$(if $(LIBFLIGHT),,cargo build --locked --release --package flight-capi)
	install -D -m 644 -t "$(INSTALLED)/include" rust/capi/include/flight.h
	install -D -m 644 -t "$(INSTALLED)/lib" "$(or $(LIBFLIGHT),target/release)/libflight.a"
	install -m 644 "$(or $(LIBFLIGHT),target/release)/libflight.so" "$(INSTALLED)/lib/libflight.so.$(VERSION)"
	ln -sf libflight.so.$(VERSION) "$(INSTALLED)/lib/libflight.so.$(basename $(VERSION))"
	ln -sf libflight.so.$(basename $(VERSION)) "$(INSTALLED)/lib/libflight.so"
	install -D -m 644 -t "$(INSTALLED)/lib/cmake/flight" rust/capi/cmake/flight-config.cmake
	mkdir -p "$(INSTALLED)/lib/pkgconfig"
	sed 's/@VERSION@/$(VERSION)/' rust/capi/flight.pc.in > "$(INSTALLED)/lib/pkgconfig/flight.pc"
	sed 's/@VERSION@/$(VERSION)/' rust/capi/cmake/flight-config-version.cmake.in \
		> "$(INSTALLED)/lib/cmake/flight/flight-config-version.cmake"

audit: $(PACKAGES) ## check licences, duplicates and known vulnerabilities, as far as they can be had; write dist/sbom.json
	$(BIN)/python -m experiments.tools.supply_chain audit

fuzz: $(PACKAGES) ## try other random files, flights and faults than the tests do (MINUTES=60)
	end=$$(($$(date +%s) + 60 * $(MINUTES))); round=$$(date +%s); \
	while [ $$(date +%s) -lt $$end ]; do \
		round=$$((round + 1)); echo "round $$round"; export PROPTEST_CASES=2000 PROPTEST_RNG_SEED=$$round; \
		cargo test --locked --quiet --package flight-sim --test main fuzz && \
		cargo test --locked --quiet --package flight-sim --test allocations random || exit 1; \
	done

lint: lint-rust lint-python ## check formats, lints, types and import contracts

lint-rust: | $(BIN)/python
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets -- -D warnings

lint-python: $(PACKAGES)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(PACKAGES) ## measure every part of a tick, the crate beside Pinocchio, DAQP and Clarabel, trainings and sweeps
	cargo bench --locked --bench dynamics --bench aero
	$(BIN)/python -m experiments.tools.bench
	$(BIN)/python -m experiments.tools.bench_jax
	taskset -c 0 $(BIN)/python -m experiments.tools.bench_train
	$(BIN)/python -m experiments.tools.bench_gpu
	$(BIN)/python -m experiments.tools.bench_sweep

figures: $(PACKAGES) ## fly the paper's first two flights and the demo's, and draw every figure whose results are there
	$(BIN)/jax-aero fly test1 test2 $(GALE) $(ENGINE) --overwrite
	$(BIN)/jax-aero figures all

# SWEEPS=--all adds our own results, which takes hours. SKIP=cfd leaves out the flow around the robot, which takes OpenFOAM.
# Force models are fitted to and trained on our own simulations, or with PUBLIC_TABLE=FILE on the authors' table.
SWEEPS :=

reproduce: $(PACKAGES) ## fly, train, draw and judge what the paper has, write results/report.md and .html (half an hour of processor time)
	$(BIN)/python -m experiments.report.reproduce $(SWEEPS) $(if $(SKIP),--skip $(SKIP)) $(if $(PUBLIC_TABLE),--table $(PUBLIC_TABLE))

generated: $(PACKAGES) ## write what follows from types and kept results: schemas, types, pages
	$(BIN)/python -m experiments.tools.generated

verify: $(PACKAGES) ## compare the crate with independent implementations and stored ticks
	$(BIN)/jax-aero verify
	$(BIN)/jax-aero verify --config configs/experiments/test4.toml
	$(BIN)/python -m pytest tests/parity

docs: $(PACKAGES) ## build the documentation site into site/, the crate's own beside it
	$(BIN)/python -m mkdocs build --strict
	cargo doc --locked --no-deps --package flight-core --package flight-io --package flight-sim
	rm -rf site/rust && cp -r target/doc site/rust

lab: $(MODULE) $(LAB_PAGE)/node_modules ## build the flight lab into target/lab/, and the page of `view` and `export --html` (needs npm)
	$(call need-targets,wasm32-unknown-unknown)
	RUSTFLAGS="-C target-feature=+simd128" cargo rustc --locked --quiet --release --package flight-lab \
		--target wasm32-unknown-unknown -- -C link-arg=--strip-all
	node $(LAB_PAGE)/build.mjs jax_aero/view/page.html
	rm -rf $(LAB)
	$(BIN)/python rust/lab/build.py $(LAB_WASM) $(LAB)

$(LAB_PAGE)/node_modules: $(LAB_PAGE)/package-lock.json
	@command -v npm >/dev/null || { echo "npm is missing: apt-get install nodejs npm, or https://nodejs.org"; exit 1; }
	npm ci --prefix $(LAB_PAGE) --silent --no-audit --no-fund
	@touch $@

clean: ## remove what set-up and builds made; results stay
	rm -rf target site dist $(VENV) $(LAB_PAGE)/node_modules jax_aero/_core*.so .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps, so that a second `make demo` starts at once.
$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed; name one with PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)

# The packages of requirements.lock, by their hashes; those of the commands come first. Modules are not compiled
# here, which would need 60 MB, but when Python first imports them.
$(VENV)/.first: requirements.hashed | $(BIN)/python
	@echo "set-up 1 of 2: build tool, and what the commands need (1.4 GB, two minutes)"
	sed '/^# ---/q' $< > $@.txt
	$(BIN)/python -m pip install --quiet --no-compile --require-hashes -r $@.txt
	@mv $@.txt $@

$(MODULE): $(VENV)/.first pyproject.toml $(RUST_SOURCES)
	@echo "set-up 2 of 2: compile the Rust module (two minutes on two cores)"
	PIP_QUIET=1 PIP_NO_INDEX=1 VIRTUAL_ENV="$(abspath $(VENV))" env -u CONDA_PREFIX \
		$(BIN)/maturin develop --release --locked --quiet
	@touch $@

$(TESTING): requirements.hashed | $(MODULE)
	@echo "set-up of the tests: independent solvers, pytest"
	sed '/^# --- make test-all/q' $< > $@.txt
	$(BIN)/python -m pip install --quiet --no-compile --require-hashes -r $@.txt
	@mv $@.txt $@

$(PACKAGES): requirements.hashed | $(TESTING)
	@echo "set-up of everything else: clusters, flow, Warp, documents, Pinocchio (2 GB, some minutes)"
	$(BIN)/python -m pip install --quiet --no-compile --require-hashes -r requirements.hashed
	@touch $@

# Holescout: the dataset pipeline and the checks, as one dependency graph.
#
#   make dataset                 the fixtures, into build/helsinki/dataset
#   make dataset OSM=city.osm.pbf RSRP=maps OUT=build/city [CONFIG=city.toml]
#   make verify-rebuild          the dataset once more from its inputs: the same SHA-256 for every file
#   make evaluate [SPLIT=val]    all methods on the dataset: OUT/evaluation/SPLIT/report.html
#   make release VERSION=1.2.0   the dataset as it is published: OUT/release/NAME-1.2.0 and .tar
#   make maps [TRACE_FLAGS=..]   scenes of the tiles, and their radio maps by Sionna RT: OUT/scenes, OUT/maps
#   make train [UPDATES=n]       a Q-network on the dataset: OUT/run, OUT/evaluation/agent/report.html
#   make evaluate DATASET=dir    and `make train DATASET=dir`: the same on a dataset that is there
#   make sanjose                 all methods on the dataset of San Jose in this repository
#   make wheel                   the Python package, with the command: dist/holescout-*.whl
#   make test                    everything that needs no large data
#   make test-real DATA=dir      against GDAL, PROJ and whole cities
#   make fuzz [FUZZ_SECONDS=60]  the readers of other people's files, each target so long
#
# Nothing is redone whose inputs did not change.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.SUFFIXES:

FIXTURE := fixtures/helsinki
# The dataset of a city that lies in the repository.
SANJOSE := datasets/sanjose-1.0.0
# Whether the dataset is one that is there, or is to be made of an extract and maps.
IS_GIVEN := $(DATASET)
OSM ?= $(FIXTURE)/helsinki.osm.pbf
RSRP ?= $(FIXTURE)/rsrp
OUT ?= build/$(or $(notdir $(IS_GIVEN:%/=%)),$(firstword $(subst ., ,$(notdir $(firstword $(OSM))))))
DATASET ?= $(OUT)/dataset
IS_FIXTURE := $(if $(IS_GIVEN),,$(filter $(FIXTURE)/%,$(OSM)))
CONFIG ?= $(if $(IS_FIXTURE),$(FIXTURE)/holescout.toml)
# The fixtures are too small for a test split.
SPLIT ?= $(if $(IS_FIXTURE),all,test)
DATA ?= ../shared/data
CHROMIUM ?= $(or $(shell command -v chromium || command -v chromium-browser || command -v google-chrome),/usr/bin/chromium)

BIN := target/release/holescout
VENV := .venv
PYTHON := $(VENV)/bin/python
REAL := tests/real
LIBTORCH := $(CURDIR)/.libtorch
SIONNA := .venv-sionna
PACKAGE := .venv-python
TORCH := LIBTORCH=$(LIBTORCH)

# A virtual environment; python3-venv is installed where that is possible without asking.
venv = python3 -m venv $1 || { \
	  [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && \
	  apt-get update -qq && apt-get install -qqy --no-install-recommends python3-venv && \
	  python3 -m venv $1; }

RUN = $(BIN) $(if $(CONFIG),--config $(CONFIG))

.PHONY: help
help:
	@sed -n '3,18s/^# *//p' Makefile

## The pipeline -----------------------------------------------------------------

.PHONY: dataset
dataset: $(OUT)/.verified
	@echo "dataset: $(DATASET)"

$(OUT)/tiles/manifest.json: $(OSM) $(CONFIG) $(OUT)/.inputs $(BIN)
	$(RUN) rasterise --osm $(OSM) --out $(@D) --overwrite
	@touch $@

$(OUT)/rsrp/manifest.json: $(OUT)/tiles/manifest.json $(RSRP) $(wildcard $(RSRP)/*)
	$(RUN) import-rsrp --maps $(RSRP) --tiles $(OUT)/tiles --out $(@D) --overwrite
	@touch $@

$(OUT)/dataset/manifest.json: $(OUT)/rsrp/manifest.json
	$(RUN) shard --tiles $(OUT)/tiles --rsrp $(OUT)/rsrp --out $(@D) --overwrite
	@touch $@

$(OUT)/.verified: $(DATASET)/manifest.json | $(BIN)
	$(BIN) verify $(DATASET)
	@mkdir -p $(@D)
	@touch $@

# The dataset is built once more, elsewhere, from the inputs that its manifest records.
.PHONY: verify-rebuild
verify-rebuild: dataset
	$(BIN) verify $(DATASET) --rebuild --osm $(OSM) --maps $(RSRP)

# The dataset with a version, as a directory and an archive; RELEASE_FLAGS="--url .. --creator .. --previous DIR" and the like go
# to `holescout release`. Without a DATE it tells none: the same command gives the same bytes tomorrow. A version that is there
# with other bytes is refused; RELEASE_FLAGS=--overwrite replaces it.
NAME ?= $(notdir $(OUT))
RELEASE = $(OUT)/release/$(NAME)-$(VERSION)
.PHONY: release
release: $(OUT)/.verified
	@test -n '$(VERSION)' || { echo "say which: make release VERSION=1.2.0" >&2; exit 2; }
	$(RUN) release $(DATASET) --version $(VERSION) --name $(NAME) $(if $(DATE),--date $(DATE)) $(RELEASE_FLAGS) \
	  --tar --out $(RELEASE)
	$(BIN) verify $(RELEASE)
	@echo "release: $(RELEASE)"

# Precision and recall of all methods on a split, with a report to look at.
.PHONY: evaluate
evaluate: $(OUT)/evaluation/$(SPLIT)/manifest.json
	@echo "report: $(<D)/report.html"

$(OUT)/evaluation/$(SPLIT)/manifest.json: $(OUT)/.verified
	$(RUN) evaluate --dataset $(DATASET) --split $(SPLIT) --out $(@D) --overwrite $(EVALUATE_FLAGS)
	@touch $@

# A Q-network by Double DQN, from the last checkpoint on if there is one; then it is judged beside the other methods on
# the validation split.
.PHONY: train
train: $(OUT)/.verified $(LIBTORCH)/.installed | tools-torch
	$(TORCH) cargo build --release --locked --features torch
	$(RUN) train --dataset $(DATASET) --run $(OUT)/run $(if $(UPDATES),--updates $(UPDATES))
	$(RUN) evaluate --dataset $(DATASET) --split val --policy $(OUT)/run/best --out $(OUT)/evaluation/agent --overwrite

# The dataset of San Jose in this repository: verified, all methods judged on its test split. Its index.html shows the records.
.PHONY: sanjose
sanjose:
	$(MAKE) evaluate DATASET=$(SANJOSE) EVALUATE_FLAGS='--starts 80'
	@echo "records: $(SANJOSE)/index.html"

# The same dataset once more from its inputs; the extract is not in the repository.
.PHONY: sanjose-rebuild
sanjose-rebuild: $(BIN) $(VENV)/.installed
	rm -rf build/sanjose-maps
	$(PYTHON) pipeline/map_packs.py unpack $(SANJOSE) --about datasets/sanjose-maps/about.xz --out build/sanjose-maps
	$(BIN) verify $(SANJOSE) --rebuild --osm $(DATA)/osm/sanjose_buildings.osm.pbf --maps build/sanjose-maps

# Other file names are other inputs, though no file became newer.
$(OUT)/.inputs: FORCE
	@mkdir -p $(@D)
	@echo '$(OSM) | $(RSRP) | $(CONFIG)' | cmp -s - $@ || echo '$(OSM) | $(RSRP) | $(CONFIG)' > $@

.PHONY: FORCE
FORCE:

# Radio maps of the tiles' scenes, traced with Sionna RT: on a GPU if there is one, else on the CPU. Of the fixtures' 132 scenes
# a few are traced; SCENES and MAPS name other directories.
SCENES ?= $(OUT)/scenes
MAPS ?= $(OUT)/maps
TRACE_FLAGS ?= $(if $(filter $(FIXTURE)/%,$(OSM)),--limit 4)
.PHONY: maps
maps: $(if $(filter $(OUT)/scenes,$(SCENES)),$(SCENES)/manifest.json) llvm
	$(SIONNA)/bin/python pipeline/sionna_trace.py $(SCENES) --out $(MAPS) $(TRACE_FLAGS)

$(OUT)/scenes/manifest.json: $(OUT)/tiles/manifest.json
	$(RUN) scenes --osm $(OSM) --tiles $(OUT)/tiles --out $(@D) --overwrite $(SCENE_FLAGS)
	@touch $@

## Building ---------------------------------------------------------------------

# Cargo knows its own graph, and leaves the file alone when nothing changed.
$(BIN): FORCE | tools
	cargo build --release --locked

.PHONY: build
build: $(BIN)

# A C compiler builds Zstandard. It is installed where that is possible without asking.
.PHONY: tools
tools:
	@command -v cargo >/dev/null || { echo "cargo is missing: install Rust from https://rustup.rs" >&2; exit 1; }
	@command -v cc >/dev/null || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && apt-get install -qqy --no-install-recommends gcc libc6-dev; \
	  else echo "a C compiler is missing: install gcc" >&2; exit 1; fi; }

# libtorch for training, 540 MB instead of 3 GB: on a CPU `libtorch_cpu.so` needs two small libraries of CUDA beside
# itself and nothing else of it. `libtorch.so`, which would ask for all of CUDA, is replaced by a linker script.
.PHONY: libtorch
libtorch: $(LIBTORCH)/.installed

.PHONY: tools-torch
tools-torch: | tools
	@command -v c++ >/dev/null || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && apt-get install -qqy --no-install-recommends g++; \
	  else echo "a C++ compiler is missing: install g++" >&2; exit 1; fi; }

$(LIBTORCH)/.installed: pipeline/libtorch-requirements.txt | $(VENV)/.installed
	rm -rf $(LIBTORCH)
	$(VENV)/bin/pip install -q --no-deps --no-compile --target $(LIBTORCH)/wheels -r $<
	mkdir -p $(LIBTORCH)/lib
	ln -s wheels/torch/include $(LIBTORCH)/include
	cd $(LIBTORCH)/lib && for library in libtorch_cpu.so libc10.so libgomp.so.1 libcudart.so.13 libcupti.so.13; do \
	  ln -s "$$(find ../wheels -name $$library | head -n 1)" $$library && test -e $$library; done
	echo 'INPUT ( libtorch_cpu.so )' > $(LIBTORCH)/lib/libtorch.so
	@touch $@

# Sionna RT and all that it imports, 690 MB.
$(SIONNA)/.installed: pipeline/sionna-requirements.txt
	$(call venv,$(SIONNA))
	$(SIONNA)/bin/pip install -q -r $<
	@touch $@

# What Sionna compiles its kernels with where there is no GPU; the program knows where to look for it.
LIBLLVM := libllvm19
.PHONY: llvm
llvm: $(SIONNA)/.installed
	@PYTHONPATH=pipeline $(SIONNA)/bin/python -c 'import sionna_trace; raise SystemExit(not sionna_trace.find_llvm())' \
	  || command -v nvidia-smi >/dev/null || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && apt-get install -qqy --no-install-recommends $(LIBLLVM); \
	  else echo "LLVM 19 is missing: install $(LIBLLVM), or set DRJIT_LIBLLVM_PATH to libLLVM.so of 19 or newer" >&2; exit 1; fi; }

## Python -----------------------------------------------------------------------

# The package for Python: library and command. One wheel serves CPython 3.10 and newer.
.PHONY: wheel
wheel: $(PACKAGE)/.installed | tools
	cargo build --release --locked --features remote
	install -D target/release/holescout python/holescout.data/scripts/holescout
	rm -rf dist
	$(PACKAGE)/bin/maturin build --quiet --release --locked --manifest-path python/Cargo.toml --out dist
	@ls dist/*.whl

$(PACKAGE)/.installed: tests/python/requirements.txt tests/python/torch-requirements.txt tests/torch/requirements.txt
	$(call venv,$(PACKAGE))
	$(PACKAGE)/bin/pip install -q -r tests/python/requirements.txt -r tests/torch/requirements.txt
	@# These ask for PyTorch, which is there as libtorch.
	$(PACKAGE)/bin/pip install -q --no-deps -r tests/python/torch-requirements.txt
	@touch $@

# PyTorch's wheel is that of libtorch, beside empty libraries in the place of CUDA's.
STUBS := $(LIBTORCH)/stubs/.installed
$(STUBS): tests/torch/stub_cuda.py $(LIBTORCH)/.installed | $(VENV)/.installed
	$(PYTHON) $< $(LIBTORCH)/wheels $(@D)
	@touch $@
WITH_TORCH := PYTHONPATH=$(LIBTORCH)/wheels LD_LIBRARY_PATH=$(LIBTORCH)/stubs:$(LIBTORCH)/wheels/nvidia/cu13/lib

## Checks -----------------------------------------------------------------------

.PHONY: check
check: fmt-check lint doc schema-check

.PHONY: fmt-check
fmt-check: | tools
	cargo fmt --check
	cargo fmt --check --package holescout-python
	cargo fmt --check --manifest-path fuzz/Cargo.toml

.PHONY: lint
lint: | tools
	cargo clippy --locked --all-targets --features remote -- -D warnings
	cargo clippy --locked --lib --bins -- -D warnings
	cargo clippy --locked --package holescout-python -- -D warnings
	@# Each feature alone: what others bring along is not taken for granted.
	for features in '' build report remote; do \
	  cargo clippy --locked --lib --no-default-features --features "$$features" -- -D warnings || exit 1; done
	@# fuzz/ has a lock file of its own, which a new dependency here leaves behind.
	cargo metadata --locked --format-version 1 --manifest-path fuzz/Cargo.toml > /dev/null

.PHONY: doc
doc: | tools
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --features remote

.PHONY: schemas
schemas: $(BIN)
	$(BIN) schemas --out schemas

.PHONY: schema-check
schema-check: $(BIN)
	$(BIN) schemas --out schemas --check

.PHONY: test
test: test-rust test-torch test-report test-release test-remote test-python

.PHONY: test-rust
test-rust: | tools
	cargo test --locked --no-fail-fast --features remote

# What needs libtorch, with the other feature beside it: lints, unit tests, training end to end, losses and gradients against
# PyTorch. The wheel of PyTorch is that of libtorch; empty libraries stand in for those of CUDA that it would ask for.
.PHONY: test-torch
test-torch: dataset $(STUBS) | tools-torch
	$(TORCH) cargo clippy --locked --features torch,remote --all-targets -- -D warnings
	$(TORCH) cargo test --locked --features torch,remote --lib -- rl::agent train::
	$(TORCH) cargo test --locked --features torch,remote --test train --test runs
	$(TORCH) cargo build --locked --features torch,remote --bin holescout --example ddqn_reference
	$(WITH_TORCH) \
	  HOLESCOUT=$(abspath target/debug/holescout) HOLESCOUT_DATASET=$(abspath $(OUT))/dataset \
	  DDQN_REFERENCE=$(abspath target/debug/examples/ddqn_reference) \
	  $(PYTHON) -m pytest -q tests/torch

# The report of an evaluation in a real browser.
.PHONY: test-report
test-report: dataset $(VENV)/.installed | browser
	HOLESCOUT=$(abspath $(BIN)) HOLESCOUT_DATASET=$(abspath $(OUT))/dataset CHROMIUM=$(CHROMIUM) \
	  $(PYTHON) -m pytest -q tests/report

# A release is valid Croissant, and its card's lines and the examples read it.
.PHONY: test-release
test-release: dataset $(VENV)/.installed | browser
	HOLESCOUT=$(abspath $(BIN)) HOLESCOUT_DATASET=$(abspath $(OUT))/dataset CHROMIUM=$(CHROMIUM) $(PYTHON) -m pytest -q tests/release

# The wheel as it is installed: its tests, the examples, and its types.
.PHONY: test-python
test-python: dataset wheel $(STUBS)
	cargo build --locked --features remote --example trajectories
	$(PACKAGE)/bin/pip install -q --no-deps --force-reinstall dist/*.whl
	$(PACKAGE)/bin/ruff check -q --config python/pyproject.toml python tests/python
	cd python && $(abspath $(PACKAGE))/bin/mypy --no-error-summary holescout
	cd tests/python && $(WITH_TORCH) HOLESCOUT_DATASET=$(abspath $(OUT))/dataset \
	  TRAJECTORIES=$(abspath target/debug/examples/trajectories) $(abspath $(PACKAGE))/bin/python -m pytest -q .

# Datasets on servers: HTTP and S3 on loopback, through connections that fail and change bytes.
.PHONY: test-remote
test-remote: dataset $(VENV)/.installed | tools
	cargo test --locked --features remote --lib store::remote
	cargo build --locked --features remote --bin holescout --example stream
	HOLESCOUT=$(abspath target/debug/holescout) HOLESCOUT_STREAM=$(abspath target/debug/examples/stream) \
	  HOLESCOUT_DATASET=$(abspath $(OUT))/dataset $(PYTHON) -m pytest -q tests/remote

# Tracing with Sionna itself: geometry, maps, a killed run, and the way from OpenStreetMap to a dataset.
.PHONY: test-sionna
test-sionna: $(BIN) $(SIONNA)/.installed-tests | llvm
	HOLESCOUT=$(abspath $(BIN)) $(SIONNA)/bin/python -m pytest -q tests/sionna

$(SIONNA)/.installed-tests: tests/sionna/requirements.txt $(SIONNA)/.installed
	$(SIONNA)/bin/pip install -q -r $<
	@touch $@

.PHONY: browser
browser:
	@test -x '$(CHROMIUM)' || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && apt-get install -qqy --no-install-recommends chromium; \
	  else echo "Chromium is missing: install it, or set CHROMIUM to its path" >&2; exit 1; fi; }

# Fails, and does not pass, where the data are missing. The example is the one that `test-rust` builds.
.PHONY: test-real
test-real: $(BIN) $(VENV)/.installed llvm
	@test -d $(DATA)/osm -a -d $(DATA)/rsrp || { echo "no data in $(DATA): set DATA to the directory with osm/ and rsrp/" >&2; exit 1; }
	cargo build --locked --features remote --example utm_points
	$(PYTHON) fixtures/geometry/make_pbf.py --check
	HOLESCOUT=$(abspath $(BIN)) HOLESCOUT_DATA=$(abspath $(DATA)) $(SIONNA)/bin/python $(REAL)/sionna_scenes.py
	$(MAKE) sanjose-rebuild
	HOLESCOUT=$(abspath $(BIN)) HOLESCOUT_DATA=$(abspath $(DATA)) $(PYTHON) -m pytest -q $(REAL)

$(VENV)/.installed: $(addprefix tests/,$(addsuffix /requirements.txt,real report torch release remote))
	$(call venv,$(VENV))
	$(VENV)/bin/pip install -q $(addprefix -r ,$^)
	@touch $@

## Fuzzing ----------------------------------------------------------------------

# libFuzzer without a sanitizer runs on stable Rust: the readers are safe Rust, and an allocator of the targets' own
# ends a run that takes too much memory. These are the flags that cargo-fuzz passes.
FUZZ := target/fuzz
FUZZ_SECONDS ?= 60
FUZZ_TARGETS ?= $(sort $(basename $(notdir $(wildcard fuzz/fuzz_targets/*.rs))))
FUZZ_FLAGS := --cfg fuzzing -Ccodegen-units=1 -Cpasses=sancov-module $(addprefix -Cllvm-args=-sanitizer-coverage-,level=4 \
  inline-8bit-counters pc-table trace-compares)
FUZZ_HOST = $(shell rustc -vV | sed -n 's/^host: //p')

# A crash leaves its input in target/fuzz/crashes; to run it again: target/fuzz/<host>/fuzz/<target> <input>
.PHONY: fuzz
fuzz: | tools-torch
	RUSTFLAGS='$(FUZZ_FLAGS)' cargo build --locked --profile fuzz --manifest-path fuzz/Cargo.toml \
	  --target-dir $(FUZZ) --target $(FUZZ_HOST) --bins
	@for target in $(FUZZ_TARGETS); do \
	  mkdir -p $(FUZZ)/corpus/$$target $(FUZZ)/crashes/$$target; \
	  dictionary=fuzz/dictionaries/$$target.dict; \
	  $(FUZZ)/$(FUZZ_HOST)/fuzz/$$target $(FUZZ)/corpus/$$target fuzz/seeds/$$target \
	    $$(test ! -e $$dictionary || echo -dict=$$dictionary) -artifact_prefix=$(FUZZ)/crashes/$$target/ \
	    -max_total_time=$(FUZZ_SECONDS) -timeout=10 -rss_limit_mb=1024 > $(FUZZ)/$$target.log 2>&1 \
	    || { tail -n 50 $(FUZZ)/$$target.log >&2; echo "fuzz: $$target failed" >&2; exit 1; }; \
	  echo "fuzz: $$target: $$(sed -n 's/^Done \(.*\) in .*/\1/p' $(FUZZ)/$$target.log)"; \
	done

# Writes fuzz/seeds anew; tests/fuzz_seeds.rs looks at whether they are still read.
.PHONY: fuzz-seeds
fuzz-seeds: dataset $(VENV)/.installed
	$(PYTHON) -B fuzz/make_seeds.py $(OUT)/dataset fuzz/seeds

## Speed ------------------------------------------------------------------------

STAGES_BENCH := target/release/stages_bench
.PHONY: bench
bench: $(BIN) dataset $(VENV)/.installed
	cargo bench --locked --bench stages -- $(abspath $(DATA))/osm/sanjose_buildings.osm.pbf
	HOLESCOUT_DATASET=$(abspath $(OUT))/dataset cargo bench --locked --bench task
	cargo build --release --locked --example encode_states
	HOLESCOUT_DATASET=$(abspath $(OUT))/dataset ENCODE_STATES=$(abspath target/release/examples/encode_states) \
	  $(PYTHON) benches/encode_vs_numpy.py
	$(VENV)/bin/pip install -q -r benches/requirements.txt
	HOLESCOUT=$(abspath $(BIN)) HOLESCOUT_DATA=$(abspath $(DATA)) $(PYTHON) benches/rasterise_vs_peers.py
	@command -v osmium >/dev/null && command -v gdal_rasterize >/dev/null || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && apt-get install -qqy --no-install-recommends osmium-tool gdal-bin; \
	  else echo "osmium or gdal_rasterize is missing: install osmium-tool and gdal-bin" >&2; exit 1; fi; }
	cargo bench --locked --bench stages --no-run --message-format=json \
	  | sed -n 's/.*"name":"stages".*"executable":"\([^"]*\)".*/\1/p' | xargs -I{} cp {} $(STAGES_BENCH)
	HOLESCOUT=$(abspath $(BIN)) HOLESCOUT_DATA=$(abspath $(DATA)) STAGES=$(abspath $(STAGES_BENCH)) \
	  $(PYTHON) benches/parts_vs_peers.py

# Downsampling of radio maps against maps that were traced coarsely.
.PHONY: bench-downsampling
bench-downsampling: llvm
	@test -n '$(SCENES)' -a -n '$(TILES)' || { echo "say which: make bench-downsampling SCENES=dir TILES='id id'" >&2; exit 2; }
	$(SIONNA)/bin/python benches/downsampling.py $(SCENES) $(TILES)

# How sure a coverage hole is: traces what is missing of the study, hours of it, to STORE, and adds what is finished to benches/labels.
.PHONY: bench-labels
bench-labels: $(BIN) llvm
	@test -n '$(STORE)' || { echo "say where traces are kept: make bench-labels STORE=dir" >&2; exit 2; }
	HOLESCOUT=$(abspath $(BIN)) HOLESCOUT_DATA=$(abspath $(DATA)) $(SIONNA)/bin/python benches/label_reliability.py trace $(STORE)
	$(SIONNA)/bin/python benches/label_reliability.py pack $(STORE)
	$(SIONNA)/bin/python benches/label_reliability.py report

# Training against two programs in PyTorch, and where its time goes. TRAINED names a larger dataset than the fixtures.
TRAINED ?= $(OUT)/dataset
TRAIN_BENCH := target/release/train_bench
.PHONY: bench-train
bench-train: dataset $(STUBS) | tools-torch
	cargo build --release --locked --example encode_states
	$(TORCH) cargo bench --locked --features torch --bench train --no-run --message-format=json \
	  | sed -n 's/.*"name":"train".*"executable":"\([^"]*\)".*/\1/p' | xargs -I{} cp {} $(TRAIN_BENCH)
	$(TRAIN_BENCH) $(TRAINED)
	$(WITH_TORCH) \
	  HOLESCOUT_DATASET=$(abspath $(TRAINED)) TRAIN_BENCH=$(abspath $(TRAIN_BENCH)) \
	  ENCODE_STATES=$(abspath target/release/examples/encode_states) $(PYTHON) benches/train_vs_pytorch.py

# What each part of the trainer is worth: trains what is missing of the variants to STORE, 40 minutes of two cores each at most.
LEARNING_FLAGS ?=
.PHONY: bench-learning
bench-learning: dataset $(LIBTORCH)/.installed | tools-torch
	@test -n '$(STORE)' || { echo "say where runs are kept: make bench-learning STORE=dir TRAINED=dataset" >&2; exit 2; }
	$(TORCH) cargo build --release --locked --features torch
	HOLESCOUT=$(abspath $(BIN)) $(PYTHON) benches/learning/learning.py train $(TRAINED) $(STORE) $(LEARNING_FLAGS)
	$(PYTHON) benches/learning/learning.py report $(STORE)

# Records a second against WebDataset, MosaicML Streaming and LitData, which need other versions of NumPy than the tests do.
LOADER_VENV := .venv-loader
LOADER_BENCH := target/release/loader_bench
.PHONY: bench-loader
bench-loader: dataset wheel $(STUBS) $(LOADER_VENV)/.installed
	$(LOADER_VENV)/bin/pip install -q --no-deps --force-reinstall dist/*.whl
	cargo bench --locked --bench loader --no-run --message-format=json \
	  | sed -n 's/.*"name":"loader".*"executable":"\([^"]*\)".*/\1/p' | xargs -I{} cp {} $(LOADER_BENCH)
	$(WITH_TORCH) HOLESCOUT_DATASET=$(abspath $(TRAINED)) LOADER_BENCH=$(abspath $(LOADER_BENCH)) \
	  $(LOADER_VENV)/bin/python benches/loader_vs_peers.py $(LOADER_FLAGS)

# Steps a second of the environment from Python, on one core.
.PHONY: bench-python
bench-python: dataset wheel
	cargo build --release --locked --example encode_states
	$(PACKAGE)/bin/pip install -q --no-deps --force-reinstall dist/*.whl
	$(PACKAGE)/bin/pip install -q -r benches/python-requirements.txt
	PYTHONPATH=benches HOLESCOUT_DATASET=$(abspath $(OUT))/dataset ENCODE_STATES=$(abspath target/release/examples/encode_states) \
	  $(PACKAGE)/bin/python benches/python_env.py

$(LOADER_VENV)/.installed: benches/loader-requirements.txt
	$(call venv,$(LOADER_VENV))
	$(LOADER_VENV)/bin/pip install -q --no-deps -r $<
	@touch $@

.PHONY: clean
clean:
	rm -rf build dist target $(VENV) $(SIONNA) $(LOADER_VENV) $(PACKAGE) $(LIBTORCH)

# The commands of a new user. On Debian and derivatives, each target installs what it needs.
# `make` alone lists the targets.

SHELL := /bin/sh
.DEFAULT_GOAL := help
.PHONY: help setup setup-python demo demo-repeat test latency soak hour hour-live seek endure defects judge test-python test-genicam test-display test-drivers test-viewers fleet test-slurm test-s3 bench bench-score validation golden tracker-version pictures help-texts gallery instruments vectors study fuzz programs install put uninstall take-away test-install \
	version tag release-programs stage deb test-deb sbom reproducible deny clean

export PATH := $(HOME)/.cargo/bin:$(PATH)
TARGET := $(or $(CARGO_TARGET_DIR),target)
RELEASE := $(TARGET)/release/vitreo
# Modules whose recordings bench-score scores.
SCORED := navigation shadow steady-path forceps bimanual vitrectomy peeling relocation
# Tests that were skipped in make test, a line each.
SKIPPED := $(abspath $(TARGET))/skipped.txt
PREFIX ?= /usr/local
BIN := $(DESTDIR)$(PREFIX)/bin
PROGRAMS := $(DESTDIR)$(PREFIX)/lib/vitreo
SHARE := $(DESTDIR)$(PREFIX)/share
# Of drivers: library, headers, and where they are.
LIBRARIES := $(DESTDIR)$(PREFIX)/lib
# The name by which programs load the library (drivers/c/build.rs).
SONAME := libvitreo.so.0
INCLUDE := $(DESTDIR)$(PREFIX)/include
INSTALLED = $(addprefix $(TARGET)/release/,vitreo vitreo-bridge vitreo-calibration vitreo-cameras vitreo-commission \
	vitreo-controls 	vitreo-desk vitreo-fpga-model vitreo-renderer vitreo-replay vitreo-simcore vitreo-tracker vitreo-virtual-rig)
AS_ROOT := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
# sudo where the nearest folder that there is above the place of installation may not be written.
IN_PREFIX = $(shell at="$(DESTDIR)$(PREFIX)"; until [ -e "$$at" ]; do at=$$(dirname "$$at"); done; \
	[ -w "$$at" ] || echo sudo)
# Of releases, packages and their tags: one place.
VERSION := $(shell sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)
# When the sources were written: what is packed bears this time, so that two builds are alike. Only
# there: libraries in C are compiled again where it changes.
SOURCE_DATE_EPOCH ?= $(shell git log -1 --format=%ct 2>/dev/null || date -r Cargo.toml +%s)
# Tools of packaging, each in one version, in a folder of their own.
TOOLS ?= $(CURDIR)/target/tools
tool = [ -x $(TOOLS)/bin/$(1) ] || CARGO_TARGET_DIR=$(TOOLS)/build cargo install --locked --version $(2) --root $(TOOLS) $(1)
PACKAGE := target/package
# Folders of this machine stand in no program: panics name files from the root of the sources.
CARGO_FOLDER := $(or $(CARGO_HOME),$(HOME)/.cargo)
PACKAGE_FLAGS ?= --remap-path-prefix=$(CARGO_FOLDER)=/cargo --remap-path-prefix=$(CURDIR)=/vitreo
PACKAGE_C_FLAGS ?= -ffile-prefix-map=$(CARGO_FOLDER)=/cargo -ffile-prefix-map=$(CURDIR)=/vitreo
DEB = target/debian/vitreo_$(VERSION)-1_$$(dpkg --print-architecture).deb
INSTALL := DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends

help: ## List the targets; settings in brackets are optional, as in make latency LATENCY="--duration 60"
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## Install missing tools: C and C++ compilers, Python, a Vulkan driver, Rust
	@set -eu; missing=""; \
	command -v cc >/dev/null || missing="$$missing gcc libc6-dev"; \
	command -v c++ >/dev/null || missing="$$missing g++"; \
	command -v python3 >/dev/null || missing="$$missing python3"; \
	command -v pkg-config >/dev/null || missing="$$missing pkg-config"; \
	ls /usr/lib/*/libvulkan.so.1 /usr/lib64/libvulkan.so.1 2>/dev/null | grep -q . \
		|| missing="$$missing libvulkan1"; \
	ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json 2>/dev/null | grep -q . \
		|| missing="$$missing mesa-vulkan-drivers"; \
	command -v cargo >/dev/null || command -v curl >/dev/null || missing="$$missing curl ca-certificates"; \
	if [ -n "$$missing" ]; then \
		command -v apt-get >/dev/null || { echo "please install:$$missing" >&2; exit 1; }; \
		echo "installing:$$missing"; \
		$(AS_ROOT) apt-get update -qq; $(AS_ROOT) env $(INSTALL) $$missing; \
	fi; \
	command -v cargo >/dev/null || { echo "installing Rust"; \
		curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh -s -- -y --profile minimal -c clippy -c rustfmt; }

demo: setup ## Run 20 s of surgery and check its latency; writes a recording, a report, pictures and a film to out/
	cargo build --release
	@mkdir -p out
	$(RELEASE) run --headless --instance demo --duration 20 --force --record out/demo.mcap --report out/report.json
	$(RELEASE) replay out/demo.mcap --lockstep --verify
	@echo; echo "drawn again from the recording, as a good graphics card draws it live:"
	$(RELEASE) film out/demo.mcap --force --stills out/stills --every 2
	$(RELEASE) film out/demo.mcap --force --tier 2 -o out/demo.mp4
	@echo; echo "what you have now:"; \
	echo "  pictures    out/stills/       left and right channel side by side, 2x1280x1024"; \
	echo "  film        out/demo.mp4      any player; 2x640x512"; \
	echo "  recording   out/demo.mcap     vitreo info, vitreo trace, Foxglove"; \
	echo "  report      out/report.json   every figure of the run"; echo
	@$(RELEASE) budgets out/report.json --forgive-load --brief

demo-repeat: setup ## Run the demo's latency check 20 times in a row (RUNS=10; BESIDE=50 runs a program beside it that takes half a core)
	cargo build --release
	RUNS="$(RUNS)" BESIDE="$(BESIDE)" VITREO=$(TARGET)/release packaging/tools/demo-repeat

# Scenarios wait for processes half of the time, so one thread more than there are processors runs them.
test: setup ## Check the format, lint, build, and run all tests
	cargo fmt --all --check
	cargo clippy --release --workspace --all-targets -- -D warnings
	cargo build --release --workspace
	@rm -f $(SKIPPED); mkdir -p $(dir $(SKIPPED))
	@echo "unit tests, with debug assertions and overflow checks:"
	VITREO_SKIPPED=$(SKIPPED) cargo test --release --workspace --lib --config tests/checked.toml
	@echo "all other tests, of the programs as they are shipped:"
	VITREO_SKIPPED=$(SKIPPED) RUST_TEST_THREADS=$${RUST_TEST_THREADS:-$$(($$(nproc) + 1))} \
		cargo test --release --workspace --bins --examples --test '*'
	cargo test --release --workspace --doc
	@if [ -s $(SKIPPED) ]; then echo "$$(wc -l < $(SKIPPED)) tests were skipped:"; sort $(SKIPPED); \
		else echo "no test was skipped"; fi

latency: setup ## Run the simulator three times on an idle machine; at least two runs must meet all latency budgets (LATENCY="--duration 60")
	cargo build --release
	@mkdir -p out
	for n in 1 2 3; do \
		$(RELEASE) run --headless --instance latency $(or $(LATENCY),--duration 30) --force --report out/latency-$$n.json || exit 1; done
	$(RELEASE) budgets out/latency-1.json out/latency-2.json out/latency-3.json --at-least 2

soak: setup ## Run 1,000 random programmes of 60 s in random scenes and check every step (45 min on two cores; SOAK="--programmes 20")
	cargo run --release -p validation --example soak -- $(SOAK)

hour: setup ## Run an hour of every stream, scene and module at full speed, and compare the end with the beginning (HOUR="--minutes 10 --only hard")
	cargo run --release -p validation --example hour -- $(HOUR)

hour-live: setup ## Run an hour live with picture and recording, then verify the recording (LIVE="--duration 600")
	cargo build --release
	@mkdir -p out
	$(RELEASE) run --headless --instance hour $(or $(LIVE),--duration 3600) --force --assert-tracking 0.99 --record out/hour.mcap --report out/hour.json
	$(RELEASE) replay out/hour.mcap --lockstep --verify

seek: setup ## Record an hour at full speed, then check time and memory of opening it and of seeking in it (SEEK="--minutes 10", SEEK="--scene 'module navigation' --force")
	@mkdir -p out
	cargo run --release -p validation --example seek -- $(SEEK)

defects: setup ## Plant 100 defects in recordings, and print which of them vitreo diff names (DEFECTS="--count 30 --each")
	cargo run --release -p validation --example defects -- $(DEFECTS)

judge: setup ## Plant defects in 100 streams, generate 100 streams of intact rigs, and print what the commands report (JUDGE="--seeds 20 --intact 20 --from 1")
	cargo run --release -p validation --example judge -- $(JUDGE)

fuzz: setup ## Fuzz every reader and message, 60 s each (FUZZ="--seconds 10 rig-json", FUZZ="--whole wire")
	RUSTC_WORKSPACE_WRAPPER=$(CURDIR)/proofs/fuzz/rustc-with-coverage cargo build --workspace --bin fuzz
	$(TARGET)/debug/fuzz run $(FUZZ)

endure: setup ## Kill and suspend processes 1,000 times, and withdraw disk space, memory and permissions (an hour; ENDURE="--kills 100")
	cargo build --release --workspace
	cargo run --release -p vitreo-tests --example endure -- $(ENDURE)

setup-python:
	@python3 -c 'import venv, ensurepip' 2>/dev/null || { $(AS_ROOT) apt-get update -qq; \
		$(AS_ROOT) env $(INSTALL) python3 python3-venv; }
	@[ -x .venv/bin/pip ] || python3 -m venv .venv
	.venv/bin/pip install -q -r tests/python/requirements.txt

test-python: setup setup-python ## Read a new recording with Python's mcap, and live poses through OpenIGTLink and the Lab Streaming Layer
	cargo build --release --workspace
	@mkdir -p out
	$(RELEASE) run --no-picture --direct --instance python --duration 4 --force --record out/python.mcap
	.venv/bin/python tests/python/read_recording.py out/python.mcap
	.venv/bin/python tests/python/igtl_client.py $(RELEASE) out/igtl.mcap
	.venv/bin/python tests/python/igtl_server.py $(RELEASE) out/igtl-server.mcap
	.venv/bin/python tests/python/lsl_client.py $(abspath $(TARGET))/release out/lsl.mcap

test-genicam: setup ## Run three GenICam cameras simulated by aravis: with and without lost packets, and with one that disconnects (SECONDS_EACH=60)
	@missing=""; command -v arv-fake-gv-camera-0.8 >/dev/null || missing="$$missing aravis-tools"; \
	command -v ip >/dev/null || missing="$$missing iproute2"; \
	pkg-config --exists aravis-0.8 2>/dev/null || missing="$$missing libaravis-dev libusb-1.0-0-dev"; \
	if [ -n "$$missing" ]; then $(AS_ROOT) apt-get update -qq; $(AS_ROOT) env $(INSTALL) $$missing; fi
	cargo test --release -p cameras --features genicam --lib
	cargo build --release --workspace --bins --features cameras/genicam
	SECONDS_EACH="$(SECONDS_EACH)" VITREO=$(TARGET)/release packaging/tools/test-genicam

test-display: setup ## Check the presentation times that an X server and a Wayland compositor report (installs xvfb and weston)
	@missing=""; command -v Xvfb >/dev/null || missing="$$missing xvfb"; command -v weston >/dev/null || missing="$$missing weston"; \
	if [ -n "$$missing" ]; then $(AS_ROOT) apt-get update -qq; $(AS_ROOT) env $(INSTALL) $$missing; fi
	cargo build --release --workspace
	VITREO=$(TARGET)/release packaging/tools/test-display

test-drivers: setup setup-python ## Kill a driver 100 times during a run, and install and use the Python package (KILLS=1000)
	cargo build --release --workspace
	VITREO_KILLS=$(or $(KILLS),100) cargo test --release --workspace --test scenarios drivers -- --test-threads 1
	.venv/bin/python -m pip install -q --force-reinstall ./drivers/python
	VITREO_LIBRARY=$(abspath $(TARGET))/release/libvitreo.so .venv/bin/python -c 'import vitreo; print("vitreo", vitreo.now())'

test-viewers: test-python ## Convert the recording of test-python for Rerun, and check every channel (installs 800 MB)
	.venv/bin/python -m pip install -q -r tests/python/requirements-rerun.txt
	.venv/bin/python tests/python/rerun_recording.py out/python.mcap out/rerun

# What test-slurm and test-s3 score: 1,000 recordings of 2 s, copies of four with seeds of their own.
fleet: setup
	cargo build --release
	@rm -rf out/fleet; mkdir -p out/fleet-sources
	for m in navigation shadow steady-path forceps; do \
		$(RELEASE) run --module $$m --no-picture --direct --instance fleet --duration 2 --force --record out/fleet-sources/$$m.mcap >/dev/null || exit 1; done
	cargo run -q --release -p recording --example copies -- 1000 out/fleet out/fleet-sources/*.mcap

test-slurm: fleet ## Score 1,000 recordings with Slurm on this machine (installed if missing) while workers are killed
	VITREO=$(TARGET)/release packaging/tools/test-slurm

test-s3: fleet setup-python ## Score 1,000 recordings from an object store on this machine while workers are killed and objects are lost or refused
	.venv/bin/pip install -q -r tests/python/requirements-s3.txt
	cargo test --release -p replay --features object-store --lib objects
	cargo build --release -p replay --features object-store
	.venv/bin/python tests/python/score_from_store.py $(RELEASE) out/fleet

bench: setup ## Run the benchmarks, and measure latency and CPU cost without and with the picture
	cargo bench -p fpga-model --bench scan
	cargo bench -p validation --bench collision
	cargo bench -p validation --bench tissue
	cargo run --release -p renderer -- bench render
	cargo bench -p validation --bench vitreous
	cargo bench -p replay --bench snapshot
	cargo bench -p validation --bench trace
	cargo bench -p simcore --bench transport
	cargo build --release
	@mkdir -p out
	$(RELEASE) run --no-picture --instance bench --duration 30 --force --report out/bench-no-picture.json
	$(RELEASE) run --headless --instance bench --duration 30 --force --report out/bench-headless.json

bench-score: setup ## Measure the speed of scoring on one core, without and with --resimulate
	cargo build --release
	@mkdir -p out/score
	for m in $(SCORED); do \
		$(RELEASE) run --module $$m --no-picture --direct --instance bench --force --record out/score/$$m.mcap >/dev/null || exit 1; done
	for how in "" --resimulate; do for m in $(SCORED); do \
		$(RELEASE) score out/score/$$m.mcap --jobs 1 --force --csv out/score/$$m.csv $$how || exit 1; done; \
		$(RELEASE) score $(SCORED:%=out/score/%.mcap) --jobs 1 --force --csv out/score/all.csv $$how || exit 1; done

validation: setup ## Compare the tissue with closed forms; writes pictures to docs/validation
	cargo run --release -p validation --example validation

study: setup ## Run five scripted surgeons and recorded hands through the training modules; writes docs/study.md (STUDY="--seeds 4")
	cargo run --release -p validation --example study -- --page docs/study.md $(STUDY)

golden: setup ## Renew the recording that every build must replay bit for bit; give the reason in the commit
	cargo build --release
	$(RELEASE) run --no-picture --instance golden --duration 2 --force --record tests/data/golden/peel-2s.mcap
	cargo test --release -p replay --lib leave_out -- --ignored

tracker-version: setup ## Raise the version of the tracker's arithmetic if it has changed, then renew the golden recording
	cargo test --release -p validation --test version renew -- --ignored --nocapture
	$(MAKE) golden

pictures: setup ## Renew the reference pictures of the renderer's tests; give the reason in the commit
	cargo run --release -p renderer --example pictures -- tests/data/pictures
	cargo run --release -p validation --example gallery -- --reference tests/data/pictures

help-texts: setup ## Renew the reference of all help texts
	cargo build --release
	cargo test --release --workspace --test scenarios help::renew -- --ignored --exact

gallery: setup ## Renew the pictures of the documentation
	cargo run --release -p validation --example gallery -- docs/pictures

instruments: setup ## Renew the instruments' meshes
	cargo run --release -p renderer --example instruments -- assets/instruments

vectors: setup ## Renew the test vectors of the camera hardware; give the reason in the commit
	cargo run --release -p fpga-model -- vectors --force fpga-model/vectors

# Programs that vitreo starts lie beside it; on the path is a link.
programs: setup ## Build the programs to be installed (OBJECT_STORE=1: with s3:// addresses in vitreo score)
	cargo build --release --bins --lib $(if $(OBJECT_STORE),--features replay/object-store)

# Building belongs to who calls, also under sudo; only putting files into PREFIX may need more.
install: ## Install into PREFIX (/usr/local); DESTDIR for packagers; make uninstall removes it
	$(if $(SUDO_USER),sudo -H -u $(SUDO_USER)) $(MAKE) programs OBJECT_STORE=$(OBJECT_STORE)
	$(IN_PREFIX) $(MAKE) --no-print-directory put

put:
	install -d $(BIN) $(PROGRAMS) $(SHARE)/doc/vitreo $(SHARE)/bash-completion/completions \
		$(SHARE)/zsh/site-functions $(SHARE)/fish/vendor_completions.d $(LIBRARIES)/pkgconfig $(INCLUDE)
	install -m 755 $(INSTALLED) $(PROGRAMS)
	install -m 755 $(TARGET)/release/libvitreo.so $(LIBRARIES)/$(SONAME)
	ln -sf $(SONAME) $(LIBRARIES)/libvitreo.so
	install -m 644 drivers/c/vitreo.h drivers/cpp/vitreo.hpp $(INCLUDE)
	sed 's|@PREFIX@|$(PREFIX)|; s|@VERSION@|$(VERSION)|' drivers/c/vitreo.pc.in > $(LIBRARIES)/pkgconfig/vitreo.pc
	chmod 644 $(LIBRARIES)/pkgconfig/vitreo.pc
	ln -sf ../lib/vitreo/vitreo $(BIN)/vitreo
	$(RELEASE) man --force $(SHARE)/man/man1
	$(RELEASE) completions bash > $(SHARE)/bash-completion/completions/vitreo
	$(RELEASE) completions zsh > $(SHARE)/zsh/site-functions/_vitreo
	$(RELEASE) completions fish > $(SHARE)/fish/vendor_completions.d/vitreo.fish
	install -m 644 README.md CHANGELOG.md LICENSE-MIT renderer/font/LICENSE-DejaVu.txt $(SHARE)/doc/vitreo
	cp -r docs $(SHARE)/doc/vitreo

uninstall: ## Remove what make install put into PREFIX; results and recordings are kept
	$(IN_PREFIX) $(MAKE) --no-print-directory take-away

take-away:
	rm -f $(BIN)/vitreo $(SHARE)/man/man1/vitreo.1 $(SHARE)/man/man1/vitreo-*.1
	rm -f $(SHARE)/bash-completion/completions/vitreo $(SHARE)/zsh/site-functions/_vitreo
	rm -f $(SHARE)/fish/vendor_completions.d/vitreo.fish
	rm -f $(LIBRARIES)/libvitreo.so $(LIBRARIES)/$(SONAME) $(LIBRARIES)/pkgconfig/vitreo.pc $(INCLUDE)/vitreo.h $(INCLUDE)/vitreo.hpp
	rm -rf $(PROGRAMS) $(SHARE)/doc/vitreo

test-install: ## Install into a temporary folder, run it from another folder, and uninstall it
	packaging/tools/test-install

version: ## Print the version (from Cargo.toml)
	@echo $(VERSION)

tag: ## Tag this commit as the version of Cargo.toml, with its section of CHANGELOG.md as notes
	@mkdir -p target
	@packaging/tools/release-notes $(VERSION) > target/release-notes.md
	git tag -a v$(VERSION) --cleanup=whitespace -F target/release-notes.md

release-programs stage deb test-deb sbom: export SOURCE_DATE_EPOCH := $(SOURCE_DATE_EPOCH)

release-programs:
	@$(call tool,cargo-auditable,0.7.7)
	env PATH="$(TOOLS)/bin:$$PATH" $(if $(PACKAGE_FLAGS),RUSTFLAGS="$(strip $(RUSTFLAGS) $(PACKAGE_FLAGS))") \
		$(if $(PACKAGE_C_FLAGS),CFLAGS="$(strip $(CFLAGS) $(PACKAGE_C_FLAGS))" CXXFLAGS="$(strip $(CXXFLAGS) $(PACKAGE_C_FLAGS))") \
		cargo auditable build --locked --release --bins --lib

# What the package has, as it lies on the disk of who installs it.
stage: release-programs
	rm -rf $(PACKAGE)
	$(MAKE) --no-print-directory put DESTDIR=$(PACKAGE) PREFIX=/usr
	strip --strip-unneeded $(PACKAGE)/usr/lib/vitreo/* $(PACKAGE)/usr/lib/$(SONAME)
	rm $(PACKAGE)/usr/share/doc/vitreo/LICENSE-MIT $(PACKAGE)/usr/share/doc/vitreo/CHANGELOG.md
	gzip -9n < CHANGELOG.md > $(PACKAGE)/usr/share/doc/vitreo/changelog.gz
	cargo metadata --locked --format-version 1 --filter-platform $$(rustc -vV | sed -n 's/^host: //p') > target/metadata.json
	packaging/third-party-licences target/metadata.json | gzip -9n > $(PACKAGE)/usr/share/doc/vitreo/third-party-licences.txt.gz
	packaging/debian-changelog $(VERSION) $(SOURCE_DATE_EPOCH) > $(PACKAGE)/changelog
	$(RELEASE) --no-config config init --force $(PACKAGE)/etc/vitreo/vitreo.toml

deb: stage ## Build the Debian package: target/debian/vitreo_VERSION-1_ARCHITECTURE.deb
	@$(call tool,cargo-deb,3.8.0)
	CARGO_TARGET_DIR=target $(TOOLS)/bin/cargo-deb --quiet --no-build --no-strip -p launcher -o $(DEB)
	@echo $(DEB)

test-deb: deb ## Install, boot, use, upgrade and purge the package in a fresh Debian (as root; installs lintian and debootstrap)
	@missing=""; for tool in lintian debootstrap; do command -v $$tool >/dev/null || missing="$$missing $$tool"; done; \
	command -v systemd-nspawn >/dev/null || missing="$$missing systemd-container"; \
	if [ -n "$$missing" ]; then $(AS_ROOT) apt-get update -qq; $(AS_ROOT) env $(INSTALL) $$missing; fi
	$(AS_ROOT) packaging/tools/test-deb $(DEB)

sbom: ## Write the software bill of materials (CycloneDX) to out/
	@$(call tool,cargo-cyclonedx,0.5.9)
	packaging/tools/sbom $(TOOLS)/bin/cargo-cyclonedx out

reproducible: ## Build the package in two folders and compare every byte
	TOOLS=$(TOOLS) packaging/tools/reproducible

deny: ## Check licences, sources, bans and advisories of all dependencies (ADVISORIES=skip omits the advisories)
	@$(call tool,cargo-deny,0.20.2)
	packaging/tools/deny $(TOOLS)/bin/cargo-deny

clean: ## Remove everything built, and out/
	cargo clean
	rm -rf out .venv

# make demo and make test do all of their own set-up on a fresh Debian or Ubuntu with Python 3.11 or newer.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
APT := $(if $(filter 0,$(shell id -u)),,sudo )apt-get

.PHONY: help conformance demo test test-compiled fast plain wheel tab check site docker-check bench bench-quick release publish install-check peer-packages run-figure simulator lock chromium promtool clean system-packages
.DEFAULT_GOAL := help

help:
	@echo 'make demo           install, and play the paper in about a minute'
	@echo 'make demo PAGE=1    install, and move the needle yourself in a browser'
	@echo 'make test           install everything the tests need, and run them all'
	@echo 'make check          linters, types, layers, and the site'
	@echo 'make site           the pages as a site, in build/site'
	@echo 'make fast           compile the core in place (mypyc, two minutes); make plain removes that again'
	@echo 'make wheel          build a wheel with the compiled core in dist/'
	@echo 'make tab            build the page of hapticnet gateway'
	@echo 'make docker-check   build the image and play every scenario of docker/ (needs a Docker engine)'
	@echo 'make conformance    run the suite of peers/ and write its table'
	@echo 'make bench          run every benchmark (45 minutes on a quiet machine) and write docs/benchmarks'
	@echo 'make release        build everything that is published in dist/ (CONTRIBUTING.md)'
	@echo 'make install-check  install what is published in clean Debian systems (needs root)'
	@echo 'make publish        check dist/, and print how it is published; nothing is sent without FOR_REAL=1'
	@echo 'make bench-quick    try every benchmark in five minutes, and write nothing'
	@echo 'make run-figure     draw docs/figures/run.png, the run in the README'
	@echo 'make simulator      build the firmware and the simulator that runs it (--device simavr)'
	@echo 'make clean          remove the virtual environment and all results'

demo: $(VENV)/installed-$(if $(PAGE),web,plot)
	$(BIN)/hapticnet demo $(if $(PAGE),--page)

test: system-packages chromium promtool check
	$(BIN)/pytest -n 2
	$(MAKE) test-compiled
	$(MAKE) install-check

# What each peer in another language agrees on: runs their suite and writes the table of peers/README.md.
conformance: $(VENV)/installed-dev
	PYTHONPATH=peers $(BIN)/python -m conformance.table

# The core compiled ahead of time, in a copy, so that the checkout stays plain Python: the same bytes on the wire, and
# the same figures. Tests marked `plain` replace parts of the core, which compiled code does not let them.
COPY := build/compiled
CORE_TESTS := $(addprefix tests/,channel codec control device node operator protocol scene)

test-compiled: $(VENV)/installed-dev
	rm -rf $(COPY) && mkdir -p $(COPY)
	cp -r hapticnet tests examples docs studies bench pyproject.toml hatch_build.py README.md $(COPY)
	cd $(COPY) && HAPTICNET_OPTIMISATION=1 $(CURDIR)/$(BIN)/python hatch_build.py >/dev/null
	cd $(COPY) && PYTHONPATH=$(CURDIR)/$(COPY) $(CURDIR)/$(BIN)/python -c \
		'from hapticnet.compiled import describe_core; assert describe_core() == "compiled core"'
	cd $(COPY) && PYTHONPATH=$(CURDIR)/$(COPY) $(CURDIR)/$(BIN)/python -m pytest -n 2 -m 'not docker and not plain' $(CORE_TESTS)

fast: $(VENV)/installed-dev
	$(BIN)/python hatch_build.py >/dev/null
	$(BIN)/hapticnet --version

plain:
	rm -f *__mypyc*.so && find hapticnet -name '*.so' -delete

wheel: $(VENV)/installed-dev
	HATCH_BUILD_HOOKS_ENABLE=1 $(BIN)/pip wheel -q --no-deps --no-build-isolation -w dist .
	@ls dist/*.whl

# The page of hapticnet gateway, which its wheel then has too; it needs the tools of peers/js.
TAB := extras/gateway/hapticnet_gateway/static

tab:
	$(MAKE) -C peers/js
	mkdir -p $(TAB) && cp peers/js/dist/page/* peers/js/dist/*.js peers/js/THIRD-PARTY.md $(TAB)

check: site
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	cd extras/experiment && $(CURDIR)/$(BIN)/lint-imports
	cd extras/gateway && $(CURDIR)/$(BIN)/lint-imports

# The pages as a site, in build/site. Links that lead nowhere are errors.
site: $(VENV)/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build  # with -q, it would ignore links that lead nowhere

docker-check: site
	$(BIN)/pytest -m docker tests/docker

# Recordings to try every codec on, as FILE[:FORCE[:POSITION[:SCALE]]]; the repository has none.
RECORDINGS ?=

bench: system-packages peer-packages $(VENV)/installed-dev $(VENV)/installed-peers
	$(BIN)/python bench/run.py --recordings $(RECORDINGS)

bench-quick: system-packages $(VENV)/installed-dev
	$(BIN)/python bench/run.py --quick

# Everything that is published, from the newest commit; and the check before it is.
release: system-packages $(VENV)/installed-dev
	$(BIN)/python -m release.build

# What is published, installed in clean systems without compiler and network; they are kept in build/bases.
install-check: system-packages $(VENV)/installed-dev
	$(BIN)/pytest -m install tests/release

publish: $(VENV)/installed-dev
	$(BIN)/python -m release.publish --image '$(IMAGE)' $(if $(FOR_REAL),--for-real)

peer-packages:
	@if ! command -v mosquitto >/dev/null && command -v apt-get >/dev/null; then \
		$(APT) update -qq && $(APT) install -y -qq --no-install-recommends mosquitto || echo 'no mosquitto; MQTT is left out'; \
	fi

run-figure: $(VENV)/installed-plot
	$(BIN)/python bench/report/plot_run.py docs/figures/run.png

# The C programs that bench/ measures against, the network namespaces of the two-host test, and what the firmware is
# built with and simulated in; systemd checks its units, strace what its filter permits; mmdebstrap makes clean systems.
SYSTEM_PACKAGES := gcc libc6-dev libssl-dev iproute2 gcc-avr avr-libc libsimavr-dev libelf-dev systemd strace mmdebstrap

# What peers/ is built with and tested on: a microcontroller, WebAssembly, C#, Rust.
PEER_PACKAGES := clang g++ cmake pkg-config gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm \
	lld wasi-libc libclang-rt-dev-wasm32 mono-mcs mono-runtime libmono-system-core4.0-cil rustc cargo

system-packages:
	@if ! { command -v gcc && command -v ip && command -v mmdebstrap && command -v systemd-analyze && command -v strace && command -v avr-gcc && \
			test -e /usr/include/simavr/sim_avr.h && test -e /usr/include/libelf.h && test -e /usr/include/openssl/evp.h; } >/dev/null; then \
		if command -v apt-get >/dev/null; then \
			$(APT) update -qq && $(APT) install -y -qq --no-install-recommends $(SYSTEM_PACKAGES); \
		else echo 'missing some of: $(SYSTEM_PACKAGES); the tests that need them are skipped'; fi; \
	fi
	@test -e /usr/include/fastdds || ! command -v apt-get >/dev/null || \
		{ $(APT) update -qq && $(APT) install -y -qq --no-install-recommends g++ libfastrtps-dev; } || \
		echo 'no Fast DDS here: extras/ros2 is not tested against it'
	@{ command -v clang && command -v clang++ && command -v g++ && command -v cmake && command -v wasm-ld && test -e /usr/include/wasm32-wasi && command -v mcs && command -v mono && command -v cargo && command -v node && command -v npm && \
			command -v arm-none-eabi-gcc && command -v qemu-system-arm; } >/dev/null || ! command -v apt-get >/dev/null || \
		{ $(APT) update -qq && $(APT) install -y -qq --no-install-recommends $(PEER_PACKAGES) \
			$$(command -v npm >/dev/null || echo nodejs npm); } || \
		echo 'missing some of: $(PEER_PACKAGES) nodejs npm; the tests of peers/ that need them are skipped'

# The live page is tested in Debian's Chromium. Ubuntu has it only as a snap, which these tests do not use.
chromium:
	@if ! command -v chromium >/dev/null && command -v apt-get >/dev/null; then \
		$(APT) install -y -qq --no-install-recommends chromium || echo 'no chromium; the tests in a browser are skipped'; \
	fi

# What checks the alerts. The Debian package would also start a server, so only the program is taken from it.
promtool:
	@if ! command -v promtool >/dev/null && ! test -x build/promtool && command -v apt-get >/dev/null; then \
		mkdir -p build && cd build && \
		{ apt-get download -qq prometheus || { $(APT) update -qq && apt-get download -qq prometheus; }; } && \
		dpkg-deb --fsys-tarfile prometheus_*.deb | tar -x --strip-components=3 ./usr/bin/promtool && \
		rm prometheus_*.deb || echo 'no promtool; the tests of the alerts are skipped'; \
	fi

# Versions and hashes of all that the images install, newest first; uv is taken from PyPI.
LOCK := $(BIN)/uv pip compile -q --upgrade --generate-hashes --python-version 3.11 --no-header --no-annotate \
	--custom-compile-command 'make lock'

lock: $(BIN)/python
	@$(BIN)/pip install -q --disable-pip-version-check uv
	echo hatchling | $(LOCK) pyproject.toml - --extra metrics --extra record --extra web --extra fast -o docker/locks/service.txt

simulator: system-packages
	$(MAKE) -C firmware firmware sim

$(VENV)/installed-%: pyproject.toml examples/literature/pyproject.toml extras/experiment/pyproject.toml extras/gateway/pyproject.toml $(BIN)/python
	$(BIN)/pip install -q --disable-pip-version-check -e '.[$*]' -e examples/literature -e extras/experiment $(if $(filter dev,$*),-e extras/gateway -e extras/mujoco -e extras/ros2)
	$(if $(filter dev,$*),$(BIN)/pip install -q --disable-pip-version-check --no-deps --upgrade --target $(VENV)/share/citation cffconvert==2.0.0)
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo 'hapticnet needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ...'; exit 1; }
	@if ! $(PYTHON) -c 'import ensurepip' 2>/dev/null; then \
		$(APT) update -qq && $(APT) install -y -qq --no-install-recommends python3-venv; fi
	$(PYTHON) -m venv $(VENV)

clean: plain
	rm -rf $(VENV) results build dist

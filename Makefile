# make demo   a real two-ended measurement over an emulated link, with a report
# make test   lint, types, import contracts, all tests
# make bench  the benchmarks, as tables of ratios
.PHONY: demo test bench lock clean
SHELL := /bin/bash

demo:
	@scripts/venv demo
	@.venv/bin/linkrover demo $(DEMO)

test:
	@scripts/system-packages python programs ros1 wifi browser
	@scripts/venv test
	@scripts/check

bench:
	@scripts/system-packages python ros1 bench
	@scripts/venv test
	@.venv/bin/python -m benchmarks $(BENCH)

lock:
	@PATH="$(PWD)/.venv/bin:$$PATH" scripts/lock

clean:
	rm -rf .venv .cache .mypy_cache .ruff_cache .hypothesis dist build

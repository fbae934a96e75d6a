# Needs Python 3.11, 3.12 or 3.13 with venv, and nothing else. PYTHON=... names another interpreter.
CANDIDATES := $(or $(PYTHON),python3 python3.12 python3.13 python3.11)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Three distributions, of which the core needs neither of the others.
WHEELS := . packages/care packages/paper workshop board
PROJECTS := pyproject.toml workshop/pyproject.toml board/pyproject.toml
# Half of the tests' time was XLA's: here it does not optimise, but where a test uses `optimised`.
FAST := JAX_DISABLE_MOST_OPTIMIZATIONS=1 $(BIN)/python -m pytest -m "not slow and not attack"

.PHONY: help wheels demo results bench site docs-size test test-slow attack lint types install lock clean
.DELETE_ON_ERROR:

help:
	@echo 'make demo       evaluate a robot on partners it never saw, and plot a cross-play matrix'
	@echo 'make results    write docs/log/paper.md and its figures from the tables in docs/data/paper'
	@echo 'make site       write the documentation as pages to build/site'
	@echo 'make wheels     build the packages of the program, of its data, of workshop and board to dist'
	@echo 'make docs-size  count the words of the documentation, and hold the bars of guides'
	@echo 'make bench      speed of environments, training, evaluator and registry on this machine'
	@echo 'make test       lint, types, tests'
	@echo 'make test-zoo   the fast tests of one room: base, envs, population, zoo, evaluation,'
	@echo '                front (api and cli), workshop, board, tools or benchmarks'
	@echo 'make test-slow  the tests marked slow, and a tenth of the fault-injection trials'
	@echo 'make attack     all fault-injection trials: kills, damaged files, hostile servers; some hours'
	@echo 'make lint       ruff, rules and format'
	@echo 'make types      ty'
	@echo 'make lock       resolve requirements.lock anew'
	@echo 'make clean      remove the virtual environment, the demo and caches'

demo: $(STAMP)
	$(BIN)/assistax-zoo evaluate gentle_scratch/dagger-ego-s0 --episodes 2 --out demo/persons
	$(BIN)/assistax-zoo report demo/persons --out demo/persons.html
	$(BIN)/assistax-zoo crossplay --robots 'gentle_scratch/*' --humans persons --persons 20 --episodes 2 --out demo/crossplay
	$(BIN)/assistax-zoo plot crossplay demo/crossplay --out demo/crossplay.png
	@echo
	@echo 'a robot with 200 persons, one row an episode: demo/persons'
	@echo 'its page, with the numbers that matter:       demo/persons.html'
	@echo 'cross-play of 3 robots with 20 of them:       demo/crossplay'
	@echo 'the cross-play matrix, clustered:             demo/crossplay.png'
	@echo 'more tasks with robots and persons:           gentle_bath gentle_lift gentle_feeding gentle_brushing'

results: $(STAMP)
	$(BIN)/python -m tools.release_page page --release v1 --data docs/data/paper --out docs/log/paper.md --images docs/images/paper

bench: $(STAMP)
	$(BIN)/python -m benchmarks env
	$(BIN)/python -m benchmarks evaluate
	$(BIN)/python -m benchmarks train
	$(BIN)/python -m benchmarks fetch

site: $(STAMP)
	$(BIN)/python -m tools.site
	@echo 'open build/site/index.html; with search: $(BIN)/python -m http.server -d build/site'

# The program, the parameters of its two tracks, the workshop and the board.
wheels: $(STAMP)
	rm -rf dist
	$(BIN)/python -m pip --disable-pip-version-check wheel --quiet --no-deps --no-index --no-build-isolation --wheel-dir dist $(WHEELS)
	@ls -l dist

docs-size: $(STAMP)
	$(BIN)/python -m tools.docs_size

# A file's tests share what they compile, hence a worker.
test: lint types
	$(FAST) -n 2 --dist loadfile

# Files in their order: the longest of them begin in the middle, so both workers end together.
test-slow: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "slow or attack"

test-front: TESTS = tests/api tests/cli
test-%: TESTS = tests/$*
test-%: $(STAMP)
	$(FAST) $(TESTS)

# Counts go to attack.jsonl, one line a family, failures too; docs/log/attack.md has a table of them.
# One process at a time, since times are measured.
attack: $(STAMP)
	rm -f attack.jsonl
	ASSISTAX_ATTACK=1 ASSISTAX_ATTACK_LOG=attack.jsonl $(BIN)/python -m pytest -m attack -s tests/attack; \
	status=$$?; cat attack.jsonl && exit $$status

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/ty check --python $(VENV) --error-on-warning

install: $(STAMP)

# The lock is checked hash by hash; the three distributions are built with what it has installed.
$(STAMP): requirements.lock $(PROJECTS)
	@set -e; found=; \
	for python in $(CANDIDATES); do \
		if "$$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then \
			found="$$python"; break; \
		fi; \
	done; \
	if [ -z "$$found" ]; then \
		echo "error: Python 3.11, 3.12 or 3.13 is needed; tried: $(CANDIDATES)." >&2; \
		echo "Install one (Debian 12: apt-get install python3 python3-venv), or name one: make PYTHON=/path/to/python3.11" >&2; \
		exit 1; \
	fi; \
	if ! "$$found" -c 'import ensurepip, venv' 2>/dev/null; then \
		echo "error: $$found has no venv module. On Debian: apt-get install python3-venv" >&2; exit 1; \
	fi; \
	echo "building $(VENV) with $$found: some minutes"; \
	"$$found" -m venv --clear $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --no-build-isolation --no-deps -e . -e workshop -e board
	@touch $@

lock:
	python3 -m venv .lock-venv
	.lock-venv/bin/python -m pip install --disable-pip-version-check --quiet uv
	.lock-venv/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' \
		--no-emit-package assistax-zoo --no-emit-package assistax-zoo-workshop \
		--upgrade --extra dev --extra postgres --extra s3 $(PROJECTS) -o requirements.lock > /dev/null

clean:
	rm -rf $(VENV) .lock-venv build dist demo .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

BIN ?= .venv/bin
.PHONY: help format check fast test all

help: ## list these commands
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /: /'

format: ## format, and repair what ruff can repair
	$(BIN)/ruff check --fix . && $(BIN)/ruff format .

check: ## lint, format, types, imports; runs nothing
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/mypy examples && $(BIN)/lint-imports

fast: ## the tests without those marked slow or docker
	$(BIN)/python -m pytest -n 2 -m "not slow and not docker"

test: ## all tests except docker
	$(BIN)/python -m pytest -n 2 -m "not docker"

all: ## what CI runs; makes .venv anew
	bash .ci/run

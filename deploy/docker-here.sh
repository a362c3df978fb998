#!/usr/bin/env bash
# Brings up a real Docker engine with Compose on a root Debian bookworm machine that has none and
# that reaches Debian's packages but no image registry. It is meant for test machines: where an
# engine already answers it does nothing, and it is never needed on a machine with Docker.
#
#   deploy/docker-here.sh setup > /tmp/engine.env && . /tmp/engine.env
#   deploy/docker-here.sh stop
#
# stdout carries only the variables to export; everything else goes to stderr.
# Exit codes: 0 done, 1 a step failed, 2 wrong usage, 3 this machine is not one it works on.
# shellcheck disable=SC1091,SC2016  # "$1" in single quotes belongs to mmdebstrap's hooks
set -Eeuo pipefail

STATE=${DPPO_DOCKER_DIR:-/tmp/dppo-docker}
IMAGE=python:3.11-slim      # the name the Dockerfile asks for, so that the plain command works
LABEL=dppo.stand-in         # tells the stand-in apart from the real image of that name
LOG=$STATE/dockerd.log
PIDFILE=$STATE/dockerd.pid

say() { printf 'docker-here: %s\n' "$*" >&2; }
die() { local code=$1; shift; say "$*"; exit "$code"; }

# Inside $( ) a failure is the caller's to judge, so only the main shell reports it.
trap 'if [ "$BASH_SUBSHELL" = 0 ]; then die 1 "\"$BASH_COMMAND\" failed; its own message is above."; fi' ERR

engine_answers() { docker info >/dev/null 2>&1; }

our_pid() {                 # the pid of the daemon this script started, if it still runs
    local pid
    pid=$(cat "$PIDFILE" 2>/dev/null) || return 1
    [ "$(cat "/proc/$pid/comm" 2>/dev/null)" = dockerd ] && printf '%s' "$pid"
}

check_machine() {
    [ "$(id -u)" = 0 ] || die 3 "user id is $(id -u), the engine needs root; run this as root."
    local os
    os=$(. /etc/os-release 2>/dev/null && printf '%s %s' "${ID:-unknown}" "${VERSION_CODENAME:-}") || os=unknown
    [ "$os" = 'debian bookworm' ] ||
        die 3 "this system is '$os', the recipe is for 'debian bookworm'; install Docker the usual way."
}

mirror() {                  # the Debian mirror this machine uses; no host is named here
    sed -nE 's#^(URIs:|deb )(.* )?(https?://[^ ]+).*#\3#p' \
        /etc/apt/sources.list.d/debian.sources /etc/apt/sources.list 2>/dev/null | head -n 1 || true
}

apt_of_trixie() {           # apt with lists of its own: the machine's sources stay as they are
    apt-get -qq -o APT::Sandbox::User=root -o Dir::Etc::sourcelist="$STATE/apt/sources.list" \
        -o Dir::Etc::sourceparts=/dev/null -o Dir::Etc::preferencesparts=/dev/null -o Dir::State::lists="$STATE/apt/lists" \
        -o Dir::Cache="$STATE/apt/cache" "$@"
}

install_engine() {
    if [ -x /usr/sbin/dockerd ] && command -v mmdebstrap >/dev/null; then return; fi
    say "installing the engine from Debian's packages"
    apt-get -qq update
    apt-get -qq install -y --no-install-recommends docker.io iptables iproute2 mmdebstrap
}

install_compose() {         # bookworm has no Compose v2; trixie's package needs no newer library
    if docker compose version >/dev/null 2>&1; then return; fi
    say "installing Compose and Buildx from Debian trixie's packages"
    mkdir -p "$STATE"/apt/lists/partial "$STATE"/apt/cache/archives/partial "$STATE"/debs
    printf 'deb [signed-by=%s] %s trixie main\n' /usr/share/keyrings/debian-archive-keyring.gpg "$MIRROR" \
        >"$STATE/apt/sources.list"
    apt_of_trixie update
    (cd "$STATE/debs" && apt_of_trixie download docker-compose docker-buildx)
    dpkg -i "$STATE"/debs/docker-compose_*.deb "$STATE"/debs/docker-buildx_*.deb
}

start_engine() {
    if engine_answers; then return; fi
    say "starting dockerd, its log is $LOG"
    if [ ! -e "$STATE/forward.before" ]; then    # kept after a crash: dockerd's own values are not "before"
        cat /proc/sys/net/ipv4/ip_forward >"$STATE/ip_forward.before"
        iptables -S FORWARD | awk '$1 == "-P" {print $3}' >"$STATE/forward.before"
    fi
    (   # A daemon that kept our descriptors would hold the caller's locks and pipes.
        for fd in /proc/self/fd/*; do
            fd=${fd##*/}
            if [ "$fd" -gt 2 ]; then eval "exec $fd>&-"; fi
        done
        exec setsid dockerd --data-root "$STATE/root" --exec-root "$STATE/exec" --pidfile "$PIDFILE"
    ) >"$LOG" 2>&1 </dev/null &
    for _ in $(seq 150); do
        if engine_answers; then return; fi
        sleep 0.2
    done
    die 1 "dockerd did not answer within 30 s; its last line is '$(tail -n 1 "$LOG")', the rest is in $LOG."
}

build_base() {              # a stand-in for the official image, made of Debian's own Python 3.11
    if docker image inspect "$IMAGE" >/dev/null 2>&1; then return; fi
    say "building a stand-in for $IMAGE, because no registry is reached"
    local keep=()
    local change=(-c 'ENV PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8'
        -c 'ENV PIP_CERT=/etc/ssl/certs/ca-certificates.crt PIP_DISABLE_PIP_VERSION_CHECK=1'
        -c 'CMD ["python3"]' -c "LABEL $LABEL=debian-bookworm-python3.11")
    if [ -d "${PIP_FIND_LINKS:-}" ]; then
        change+=(-c 'ENV PIP_FIND_LINKS=/wheels')
        keep=(--customize-hook="mkdir -p \"\$1/wheels\" && cp \"$PIP_FIND_LINKS\"/*.whl \"\$1/wheels/\"")
    fi
    mmdebstrap --quiet --mode=root --variant=apt \
        --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
        --dpkgopt='path-exclude=/usr/share/locale/*' \
        --aptopt='Acquire::Check-Valid-Until "false"' --aptopt='Acquire::Check-Date "false"' \
        --include=python3,python3-pip,python3-venv,ca-certificates \
        --customize-hook='rm -f "$1"/usr/lib/python3.11/EXTERNALLY-MANAGED' \
        --customize-hook='ln -s /usr/bin/python3 "$1"/usr/local/bin/python' \
        --customize-hook='cp /etc/ssl/certs/ca-certificates.crt "$1"/etc/ssl/certs/ca-certificates.crt' \
        "${keep[@]}" bookworm - "deb $MIRROR bookworm main" |
        docker import "${change[@]}" - "$IMAGE" >/dev/null || {
        docker image rm -f "$IMAGE" >/dev/null 2>&1 || true     # half an image must not pass for one
        die 1 "the stand-in for $IMAGE was not built; mmdebstrap's message above says why."
    }
}

announce() {
    if ! docker image inspect -f '{{json .Config.Labels}}' "$IMAGE" 2>/dev/null | grep -q "$LABEL"; then return; fi
    say "$IMAGE on this machine is a stand-in made of Debian packages, not the official image"
    if docker run --rm --network none "$IMAGE" test -d /wheels; then
        printf "export PIP_EXTRA='--find-links /wheels'\n"
    fi
    printf 'export DPPO_REQUIRE_DOCKER=1\n'
}

setup() {
    if engine_answers && ! our_pid >/dev/null; then
        say "a Docker engine already answers here, nothing was done"
        if [ "$(id -u)" = 0 ]; then printf 'export DPPO_REQUIRE_DOCKER=1\n'; fi
        return
    fi
    check_machine
    export DEBIAN_FRONTEND=noninteractive
    MIRROR=$(mirror)
    [ -n "$MIRROR" ] || die 3 "apt's sources name no Debian mirror on this machine; add one, then run this again."
    mkdir -p "$STATE"
    install_engine >&2
    install_compose >&2
    start_engine
    build_base
    say "engine $(docker version -f '{{.Server.Version}}'), compose $(docker compose version --short), ready"
    announce
}

stop() {
    local pid forward
    pid=$(our_pid) || { say "no engine started by this script runs under $STATE, nothing was done"; return; }
    kill "$pid"
    for _ in $(seq 300); do
        if ! our_pid >/dev/null; then break; fi
        sleep 0.2
    done
    if our_pid >/dev/null; then die 1 "dockerd (pid $pid) still runs 60 s after SIGTERM; see $LOG."; fi
    # dockerd leaves its bridges, its rules, the policy DROP and ip_forward behind.
    for link in $(ip -o link show type bridge | awk -F': ' '$2 ~ /^(docker0|br-[0-9a-f]{12})$/ {print $2}'); do
        ip link del "$link"
    done
    forward=$(cat "$STATE/forward.before")
    iptables-save | grep -vE 'DOCKER|docker0|br-[0-9a-f]{12}' |
        sed "s/^:FORWARD [A-Z]*/:FORWARD ${forward:-ACCEPT}/" | iptables-restore
    cat "$STATE/ip_forward.before" >/proc/sys/net/ipv4/ip_forward
    rm "$STATE/forward.before" "$STATE/ip_forward.before"
    say "engine stopped; images and volumes stay in $STATE/root"
}

case ${1:-} in
    setup | stop) [ $# = 1 ] || die 2 "got $# arguments, expected one: setup or stop."; "$1" ;;
    *) die 2 "the step is '${1:-}', expected setup or stop; the top of this file says what they do." ;;
esac

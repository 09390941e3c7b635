"""The Docker engine and its compose plugin, for the scenarios in docker/."""

from typing import Final

from hapticnet.runtime.doctor.finding import Finding, Step, Topic, Verdict
from hapticnet.runtime.doctor.machine import Machine, Ran

SUBJECT: Final = "docker"

ANSWER_WITHIN_S: Final = 5.0


def examine_engine(machine: Machine) -> list[Finding]:
    """Return the findings about Docker."""
    if machine.program("docker") is None:
        return [judge_engine(None)]
    engine = machine.run(["docker", "version", "--format", "{{.Server.Version}}"], ANSWER_WITHIN_S)
    compose = machine.run(["docker", "compose", "version", "--short"], ANSWER_WITHIN_S)
    if compose.code != 0 and machine.program("docker-compose") is not None:
        compose = machine.run(["docker-compose", "version", "--short"], ANSWER_WITHIN_S)
    return [judge_engine(engine), judge_compose(compose)]


def judge_engine(ran: Ran | None) -> Finding:
    """Judge the engine by the answer to ``docker version``; None: there is no such program."""
    title = "Docker engine"
    if ran is None:
        topic = Topic(SUBJECT, "engine", title, {"installed": False, "version": None, "error": None})
        return topic.absent(
            "not installed; only the scenarios in docker/ need it",
            Step("If you need it:", "sudo apt-get install docker.io"),
        )
    version, error = ran.out.strip(), " ".join(ran.err.split())
    topic = Topic(SUBJECT, "engine", title, {"installed": True, "version": version or None, "error": error or None})
    if ran.code == 0 and version:
        return topic.ok(f"{version} answers")
    if ran.code is None:
        value = f"does not answer within {ANSWER_WITHIN_S:g} s"
        step = Step("Restart it:", "sudo systemctl restart docker")
    elif "permission denied" in error.lower():
        value = "permission denied"
        step = Step("Join the group docker, then log out and in again:", "sudo usermod -aG docker $USER")
    elif "cannot connect" in error.lower() or "connection refused" in error.lower():
        value = "not running"
        step = Step("Start it:", "sudo systemctl start docker")
    else:
        value = error[:200] or f"'docker version' ended with code {ran.code}"
        step = Step("See what it says:", "docker version")
    meaning = "The scenarios in docker/ cannot be played; everything else works."
    return topic.find(Verdict.WARNING, value, meaning, step)


def judge_compose(ran: Ran) -> Finding:
    """Judge the compose plugin by the answer to ``docker compose version``."""
    version = ran.out.split()[-1] if ran.code == 0 and ran.out else None
    topic = Topic(SUBJECT, "compose", "Docker compose", {"version": version})
    if version is not None:
        return topic.ok(version)
    return topic.absent(
        "not installed; only the scenarios in docker/ need it",
        Step("If you need it:", "sudo apt-get install docker-compose-v2 || sudo apt-get install docker-compose"),
    )

"""A driver that gives a list of commands, whatever it observes."""

from metropilot.sim import AbstractDriver


class Scripted(AbstractDriver):
    id, summary, source = "scripted", "A list of commands", "test"

    def __init__(self, commands):
        self.commands = commands

    def init(self, run):
        return 0

    def act(self, memory, observation):
        return float(self.commands[min(memory, len(self.commands) - 1)]), memory + 1

class HandClock:
    """A clock that is set by hand; `pace` is by how many seconds it advances when it is read."""

    def __init__(self, pace=0.0):
        self.now = 100.0
        self.pace = pace

    def __call__(self):
        self.now += self.pace
        return self.now

"""A bad link between two ends on virtual time, for cores that are driven step by step."""

from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S


class LossyPair:
    """Ground and space. By seed: datagrams are lost, doubled, overtaken; contact comes and goes.

    A pair says how an end hears of the link, takes a datagram, and what it sends.
    """

    delay_ns = 20 * NS_PER_MS
    overtaken_ns = NS_PER_S

    def __init__(
        self, seed: int = 0, *, loss: float = 0.0, doubled: float = 0.0, overtaken: float = 0.0
    ) -> None:
        self.now_ns = 0
        self.contact = True
        self._random = Random(seed)
        self._loss, self._doubled, self._overtaken = loss, doubled, overtaken
        self._flying: list[tuple[int, object, bytes]] = []

    def run(self, seconds: float, step_ns: int = 10 * NS_PER_MS) -> None:
        until_ns = self.now_ns + round(seconds * NS_PER_S)
        while self.now_ns < until_ns:
            self.now_ns += step_ns
            self.step()

    def step(self) -> None:
        now_ns, random, ends = self.now_ns, self._random, (self.ground, self.space)
        for end in ends:
            self.tell(end).handle_link(heard=self.contact, waiting_octets=0, now_ns=now_ns)
        if not self.contact:
            self._flying.clear()
        arrived = sorted((one for one in self._flying if one[0] <= now_ns), key=lambda one: one[0])
        self._flying = [one for one in self._flying if one[0] > now_ns]
        for _, end, octets in arrived:
            self.take(end, octets)
        for end, other in (ends, ends[::-1]):
            for octets in end.work(now_ns):
                self.note(end, octets)
                for _ in range(2 if random.random() < self._doubled else 1):
                    if random.random() < self._loss:
                        continue
                    late = random.random() < self._overtaken
                    late_ns = random.randrange(self.overtaken_ns) if late else 0
                    self._flying.append((now_ns + self.delay_ns + late_ns, other, octets))

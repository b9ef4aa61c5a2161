"""Any octets: a body is refused with ProtocolError, or packing it again gives the same octets.

`python tests/fuzz/test_k2aci_fuzz.py 1000000` runs that many mutations, outside CI.
"""

import sys
from random import Random

from hypothesis import given
from hypothesis import strategies as st
from mutated_octets import K2ACI_BODIES, mutate

from kontur_av.errors import ProtocolError
from telepresence.tmtc.k2aci import K2aciEndpoint, pack_body, parse_body


def run(mutations: int, seed: int) -> int:
    """Parse that many mutations; return how many were bodies."""
    random = Random(seed)
    endpoint = K2aciEndpoint(life=1)
    bodies = 0
    for count in range(mutations):
        octets = mutate(random, random.choice(K2ACI_BODIES))
        try:
            assert pack_body(parse_body(octets)) == octets
            bodies += 1
        except ProtocolError:
            pass
        if count % 10 == 0:
            endpoint.handle_message(octets, count)
            while endpoint.next_event():
                pass
    return bodies


def test_mutated_bodies_are_refused_or_pack_to_the_same_octets() -> None:
    assert run(5_000, seed=1) > 100


@given(st.binary(max_size=240))
def test_any_octets_never_raise(octets: bytes) -> None:
    K2aciEndpoint(life=1).handle_message(octets, 0)


if __name__ == "__main__":
    print(run(int(sys.argv[1]), seed=2), "of", sys.argv[1], "were bodies")

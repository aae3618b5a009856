"""Products of compiled updates against torch's own, where this CPU has the kernel for them."""

import copy
import pickle

import pytest
import torch

from deep_curiosity.speed import matmul
from deep_curiosity.speed.matmul import INSTRUCTIONS, direct_matmul
from tests.speed.programs import output_of

pytestmark = pytest.mark.skipif(
    torch.backends.cpu.get_cpu_capability() not in INSTRUCTIONS, reason="needs another CPU"
)

OPERANDS = {
    "rows": "matrices(3, 5, 7), matrices(3, 7, 4)",
    "one matrix": "matrices(5, 7), matrices(7, 40)",
    "a batch of one": "matrices(1, 128, 17), matrices(1, 17, 256)",
    "left transposed": "matrices(3, 20, 33).mT, matrices(3, 20, 17)",
    "right transposed": "matrices(3, 33, 20), matrices(3, 17, 20).mT",
    "both transposed": "matrices(2, 16, 48).mT, matrices(2, 5, 16).mT",
    "the same for all": "matrices(5, 7).expand(4, 5, 7), matrices(4, 7, 2)",
    "the same rows": "matrices(2, 1, 7).expand(2, 5, 7), matrices(2, 1, 20).expand(2, 7, 20)",
    "the same columns": "matrices(2, 5, 7), matrices(2, 7, 1).expand(2, 7, 3)",
    "part of a matrix": "matrices(2, 9, 12)[:, 2:7, 3:8], matrices(2, 5, 20)[..., 1:18]",
    "every second one": "matrices(2, 9, 12)[:, ::2, ::3], matrices(2, 8, 20)[:, ::2, ::2]",
}
NOT_FLOAT32 = '"float64": (matrices(2, 5, 7).double(), matrices(2, 7, 4).double())'
COMPARE = """
import torch
from torch._inductor.utils import run_and_get_code
from deep_curiosity.speed.matmul import direct_matmul

torch.set_num_threads(1)
torch.manual_seed(0)
matrices = torch.randn
operands = {OPERANDS}

def products(pairs):
    return [left @ right for left, right in pairs]

options = {"cpp_wrapper": True, **direct_matmul()}
compiled = torch.compile(products, dynamic=False, options=options)
results, (code,) = run_and_get_code(compiled, list(operands.values()))
for name in ("aoti_torch_cpu_bmm_out", "aoti_torch_cpu_mm_out"):
    _, ours = code.split(f"#define {name}")  # what follows calls the one defined there
    print(ours.count(f"CHECK({name}("))
for (name, (left, right)), result in zip(operands.items(), results):
    exact = left.double() @ right.double()
    error = ((result - exact).norm() / exact.norm()).item()
    print(name, result.shape == exact.shape and error < 1e-6, sep=": ")
"""


@pytest.fixture
def on_one_thread():
    """One thread as in a run, and afterwards as many as before."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.slow
def test_products_are_those_of_the_matrices_however_they_lie_in_memory():
    operands = ", ".join(f"{name!r}: ({pair})" for name, pair in OPERANDS.items())
    batches, matrices, *compared = output_of(
        COMPARE.replace("OPERANDS", f"{operands}, {NOT_FLOAT32}")
    )
    assert int(batches) + int(matrices) == len(compared)
    assert compared == [f"{name}: True" for name in [*OPERANDS, "float64"]]


CACHED = """
import torch
from torch._dynamo.utils import counters
from deep_curiosity.speed.matmul import direct_matmul

torch.set_num_threads(1)
options = {"cpp_wrapper": True, **direct_matmul()}
product = torch.compile(lambda left, right: left @ right, options=options)
print(product(torch.ones(2, 3, 4), torch.ones(2, 4, 5)).sum().item())
print(counters["inductor"]["fxgraph_cache_hit"], counters["inductor"]["fxgraph_cache_bypass"])
"""


@pytest.mark.slow
def test_what_was_compiled_is_found_again_by_the_next_process(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    assert output_of(CACHED) == ["120.0", "0 0"]
    assert output_of(CACHED) == ["120.0", "1 0"]


@pytest.mark.usefixtures("on_one_thread")
def test_options_are_pickled_by_their_text_and_the_cpu(monkeypatch):
    """As torch's cache of compiled graphs does, which machines may share."""
    options, written = direct_matmul(), pickle.dumps(direct_matmul())
    assert pickle.loads(written) == options == copy.deepcopy(options)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: INSTRUCTIONS[0])
    other = pickle.dumps(direct_matmul())
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: INSTRUCTIONS[1])
    assert other != pickle.dumps(direct_matmul())


@pytest.mark.usefixtures("on_one_thread")
def test_threads_that_could_share_a_product_leave_it_to_torch():
    assert direct_matmul()
    torch.set_num_threads(2)
    assert not direct_matmul()


@pytest.mark.usefixtures("on_one_thread")
def test_less_than_float32_is_left_to_torch(monkeypatch):
    monkeypatch.setattr(matmul, "matmul_is_float32", lambda: False)
    assert not direct_matmul()

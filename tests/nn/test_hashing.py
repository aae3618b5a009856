import torch

from deep_curiosity.nn.statistics import HASH_OFFSET, scrambled


def test_every_bit_of_scrambled_numbers_is_a_fair_coin():
    number = scrambled(torch.arange(20_000) + HASH_OFFSET)
    heads = (number.unsqueeze(-1) >> torch.arange(64)) & 1
    assert (heads.double().mean(0) - 0.5).abs().max() < 0.02


def test_no_two_numbers_are_scrambled_alike_and_each_always_alike():
    number = torch.arange(10_000)
    assert len(scrambled(number).unique()) == 10_000
    assert scrambled(number).equal(scrambled(number.clone()))

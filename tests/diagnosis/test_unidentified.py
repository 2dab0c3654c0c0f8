"""What holds the scale of all torques is said, once."""

from dataclasses import replace

from gapcase import small_case

from hybrid_id.diagnosis.unidentified import not_identifiable


def test_what_holds_the_scale_is_said_and_free_scales_are_not_said_twice() -> None:
    dataset, nominal = small_case()
    assert any("one number" in words and "claim" not in words for words in not_identifiable(dataset, nominal))
    held = nominal.with_specs({"J": replace(nominal.parameter("J").spec, estimate=False)})
    words = not_identifiable(dataset, held)
    assert any("P_m1" in w and "only the claim of J at" in w for w in words), words

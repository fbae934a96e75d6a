"""Engine target `wasm`: a task's whole step, its scripts and its robots' network as one module.

`emitter` and `rules` write what JAX traces as straight-line C++, `traces` says what is traced,
`build` compiles it beside the fused engine's text. Run `python -m tools.seat build`.
"""

// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is asked of the pools of buffers.

/// Asks the pools in an allocation query for at least `more` buffers than before.
pub(super) fn raise_minimum(query: &mut gst::query::Allocation, more: u32) {
    let pools: Vec<_> = query.allocation_pools().collect();
    for (index, (pool, size, min, max)) in (0..).zip(pools) {
        let min = min.saturating_add(more);
        let max = if max == 0 { 0 } else { max.max(min) };
        query.set_nth_allocation_pool(index, pool.as_ref(), size, min, max);
    }
}

// SPDX-License-Identifier: MIT OR Apache-2.0

//! What others have published, for `eval` to compare with: ways to rectify, given correspondences, and a dense optical flow.
//!
//! Apart from `eval`, because none of it is the product's, and none of it changes when the product does.
//!
//! | module | what it holds |
//! |---|---|
//! | [`flow`] | dense optical flow, one of the sources of correspondences |
//! | [`correspondences`] | where the correspondences come from that every method is given |
//! | [`methods`] | the methods, and what they have in common |

pub mod correspondences;
pub mod flow;
pub mod methods;

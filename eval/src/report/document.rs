// SPDX-License-Identifier: MIT OR Apache-2.0

//! Fills the template of the document: prose by hand, figures by the run.

use anyhow::{Result, bail};

/// Replaces each `{{name}}` of the template by the text that `fill` knows for it.
///
/// # Errors
/// Where a name is not known or a pair of braces is open.
pub fn fill(template: &str, fill: impl Fn(&str) -> Option<String>) -> Result<String> {
    let mut parts = template.split("{{");
    let mut document = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let Some((name, rest)) = part.split_once("}}") else { bail!("the template has an open {{{{{part}") };
        let Some(text) = fill(name) else {
            bail!("the template asks for {{{{{name}}}}}, which is not known")
        };
        document += text.trim_end();
        document += rest;
    }
    Ok(document)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_replaced_and_unknown_ones_refused() {
        let known = |name: &str| (name == "a").then(|| "1\n".to_owned());
        assert_eq!(fill("x {{a}}, {{a}}\n", known).unwrap(), "x 1, 1\n");
        assert!(fill("{{b}}", known).is_err());
        assert!(fill("{{a", known).is_err());
    }
}

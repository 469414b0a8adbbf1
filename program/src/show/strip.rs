// SPDX-License-Identifier: MIT OR Apache-2.0

//! A strip of text along the lower edge of a frame, as SVG.

use crate::drawing::{Colour, SKY_BLUE, hex};

/// Size of the letters, height of a line and distance of one item from the next, at the usual size of a frame.
const LETTERS: f64 = 14.0;
const LINE: f64 = 22.0;
const GAP: f64 = 20.0;
const MARGIN: f64 = 8.0;
/// Width of a bar, and of the stroke beside a key.
const BAR: f64 = 80.0;
const KEY: f64 = 18.0;
/// Width of a letter of the font in the mean, as a share of its size, rounded up.
const LETTER: f64 = 0.58;

/// What stands in it.
pub struct Item {
    text: String,
    /// Letters that there is room for, so that what follows stays where it is from frame to frame.
    room: usize,
    mark: Mark,
}

/// What stands before or behind an item's text.
enum Mark {
    None,
    /// A stroke in this colour.
    Key(Colour),
    /// A bar that is filled by this share.
    Bar(f64),
}

impl Item {
    pub fn text(text: String) -> Self {
        Self { text, room: 0, mark: Mark::None }
    }

    /// The same with room for so many letters.
    pub fn with_room(self, room: usize) -> Self {
        Self { room, ..self }
    }

    /// What a colour stands for.
    pub fn key(colour: Colour, text: String) -> Self {
        Self { mark: Mark::Key(colour), ..Self::text(text) }
    }

    /// A share, 0 to 1, with its name.
    pub fn bar(name: &str, share: f64) -> Self {
        Self { mark: Mark::Bar(share.clamp(0.0, 1.0)), ..Self::text(format!("{name} {share:.2}")) }
    }

    /// Width of its mark at the usual size of a frame.
    fn mark_width(&self) -> f64 {
        match self.mark {
            Mark::None => 0.0,
            Mark::Key(_) => KEY + 6.0,
            Mark::Bar(_) => BAR + 8.0,
        }
    }

    fn width(&self) -> f64 {
        self.mark_width() + self.text.chars().count().max(self.room) as f64 * LETTER * LETTERS
    }

    /// From the left edge of the item, at the middle of its line; all lengths at the usual size.
    fn svg(&self, x: f64, y: f64) -> String {
        let mark = match self.mark {
            Mark::None => String::new(),
            Mark::Key(colour) => {
                format!(r##"<path d="M{x:.1} {y:.1}h{KEY}" stroke="{}" stroke-width="4"/>"##, hex(colour))
            }
            Mark::Bar(share) => format!(
                r##"<rect x="{x:.1}" y="{:.1}" width="{BAR}" height="11" fill="#fff" fill-opacity="0.25"/><rect x="{x:.1}" y="{:.1}" width="{:.2}" height="11" fill="{}"/>"##,
                y - 5.5,
                y - 5.5,
                BAR * share,
                hex(SKY_BLUE)
            ),
        };
        let (x, y) = (x + self.mark_width(), y + 0.36 * LETTERS);
        mark + &format!(r#"<text x="{x:.1}" y="{y:.1}">{}</text>"#, self.text)
    }
}

/// The strip of a frame.
pub struct Strip {
    /// The frame's width and height in pixels.
    pub size: [u32; 2],
    /// Pixels to one of the usual size.
    pub unit: f64,
}

impl Strip {
    /// The items one after another, in as many lines as they take; each group begins one.
    pub fn svg(&self, groups: &[Vec<Item>]) -> String {
        let [width, height] = self.size.map(|side| f64::from(side) / self.unit);
        let mut lines: Vec<Vec<(f64, &Item)>> = Vec::new();
        for group in groups {
            let mut x = f64::INFINITY;
            for item in group {
                if x + item.width() > width - MARGIN {
                    lines.push(Vec::new());
                    x = MARGIN;
                }
                lines.last_mut().into_iter().for_each(|line| line.push((x, item)));
                x += item.width() + GAP;
            }
        }
        let top = height - LINE * lines.len() as f64 - MARGIN;
        let text: String = lines
            .iter()
            .enumerate()
            .flat_map(|(row, line)| line.iter().map(move |(x, item)| (row, *x, *item)))
            .map(|(row, x, item)| item.svg(x, top + 0.5 * MARGIN + LINE * (row as f64 + 0.5)))
            .collect();
        format!(
            r##"<g transform="scale({})" font-family="sans-serif" font-size="{LETTERS}" fill="#fff" stroke-linecap="butt"><rect x="0" y="{top:.1}" width="{width:.1}" height="{:.1}" fill="#000" fill-opacity="0.78"/>{text}</g>"##,
            self.unit,
            height - top,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Heights at which text stands.
    fn heights(size: [u32; 2]) -> Vec<f64> {
        let items: Vec<_> = (0..4).map(|k| Item::text(format!("some words, number {k}"))).collect();
        let svg = Strip { size, unit: 1.0 }.svg(&[items, vec![Item::text("more".to_owned())]]);
        let rows = svg.split("<text ").skip(1).map(|text| {
            let y = text.split("y=\"").nth(1).and_then(|rest| rest.split('"').next());
            y.unwrap().parse::<f64>().unwrap()
        });
        rows.collect()
    }

    #[test]
    fn what_does_not_fit_goes_to_the_next_line() {
        let wide = heights([1000, 600]);
        assert!(wide[..4].iter().all(|y| *y == wide[0] && *y > 550.0), "{wide:?}");
        assert!(wide[4] > wide[0] && wide[4] < 600.0, "{wide:?}");
        let narrow = heights([420, 600]);
        assert!(narrow[0] == narrow[1] && narrow[2] == narrow[3] && narrow[0] < narrow[2], "{narrow:?}");
    }
}

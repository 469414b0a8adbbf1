// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames that wait for their motion, and the events that travel between them.

use std::collections::VecDeque;

enum Item<F, E> {
    Frame(F),
    Event(E),
}

/// Frames and serialised events in the order they came.
///
/// An event never overtakes a frame that came before it and leaves as soon as the last of those
/// has left.
pub struct Queue<F, E> {
    items: VecDeque<Item<F, E>>,
    frames: usize,
}

impl<F, E> Default for Queue<F, E> {
    fn default() -> Self {
        Self { items: VecDeque::new(), frames: 0 }
    }
}

impl<F, E> Queue<F, E> {
    /// How many frames wait.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Adds a frame.
    pub fn push_frame(&mut self, frame: F) {
        self.items.push_back(Item::Frame(frame));
        self.frames += 1;
    }

    /// Adds an event behind the frames that wait.
    pub fn push_event(&mut self, event: E) {
        self.items.push_back(Item::Event(event));
    }

    /// The frame at the front, if no event stands before it.
    pub fn front(&self) -> Option<&F> {
        match self.items.front()? {
            Item::Frame(frame) => Some(frame),
            Item::Event(_) => None,
        }
    }

    /// Takes the event at the front, if no frame stands before it.
    pub fn pop_event(&mut self) -> Option<E> {
        match self.items.pop_front()? {
            Item::Event(event) => Some(event),
            frame => {
                self.items.push_front(frame);
                None
            }
        }
    }

    /// Takes the frame at the front, if no event stands before it.
    pub fn pop_frame(&mut self) -> Option<F> {
        match self.items.pop_front()? {
            Item::Frame(frame) => {
                self.frames -= 1;
                Some(frame)
            }
            event => {
                self.items.push_front(event);
                None
            }
        }
    }

    /// Drops the frames and gives back the events, in order.
    pub fn clear(&mut self) -> Vec<E> {
        self.frames = 0;
        let events = self.items.drain(..).filter_map(|item| match item {
            Item::Event(event) => Some(event),
            Item::Frame(_) => None,
        });
        events.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_keep_their_place_between_frames() {
        let mut queue = Queue::default();
        queue.push_frame(1);
        queue.push_event("a");
        queue.push_event("b");
        queue.push_frame(2);
        assert_eq!(queue.frames(), 2);
        assert_eq!(queue.pop_event(), None);
        assert_eq!(queue.pop_frame(), Some(1));
        assert_eq!(queue.pop_frame(), None, "an event stands before frame 2");
        assert_eq!((queue.pop_event(), queue.pop_event()), (Some("a"), Some("b")));
        assert_eq!((queue.pop_frame(), queue.pop_frame()), (Some(2), None));
        assert_eq!(queue.frames(), 0);
    }

    #[test]
    fn clear_keeps_events_only() {
        let mut queue = Queue::default();
        queue.push_frame(1);
        queue.push_event("a");
        queue.push_frame(2);
        queue.push_event("b");
        assert_eq!(queue.clear(), ["a", "b"]);
        assert_eq!(queue.frames(), 0);
        assert_eq!((queue.pop_event(), queue.pop_frame()), (None, None));
    }
}

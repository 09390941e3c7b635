//! The master: positions out, forces back.

use std::ffi::CString;
use std::os::raw::c_char;
use std::ptr::{null, NonNull};

use crate::random::{draw, Source};
use crate::{
    c_text, check, counted, made, sys, text_of, Counts, Datagram, Error, Key, PrivateKey, Random, Vector, MOST_AXES,
};

/// What a master asks for. `None` is hapticnet's default.
#[derive(Clone, Debug)]
pub struct Request {
    /// How forces are compressed.
    pub codec: String,
    /// Who asks: printable, at most 64 bytes.
    pub name: String,
    /// Parameters of the codec; the others have their defaults.
    pub parameters: Vec<(String, f64)>,
    /// The just-noticeable difference of the person, as a fraction of the force. Default: 0.05.
    pub weber_fraction: Option<f64>,
    /// The smallest just-noticeable difference [N]. Default: 0.025.
    pub floor_n: Option<f64>,
    /// The threshold in just-noticeable differences. Default: 1.
    pub multiplier: Option<f64>,
    /// Positions a second, 20 to 100000. Default: 1000.
    pub rate_hz: Option<f64>,
    /// Number of axes, 1 to 3.
    pub axes: usize,
    /// For few positions, their share of that difference, 0.01 to 0.9. `None`: every position is sent.
    pub position_share: Option<f64>,
    /// Whether to render contact that the slave announces.
    pub announced: bool,
    /// Whether the slave predicts the hand.
    pub predicted: bool,
}

impl Default for Request {
    fn default() -> Request {
        Request {
            codec: "deadband".into(),
            name: "Rust".into(),
            parameters: Vec::new(),
            weber_fraction: None,
            floor_n: None,
            multiplier: None,
            rate_hz: None,
            axes: 1,
            position_share: None,
            announced: false,
            predicted: false,
        }
    }
}

impl Request {
    /// Return the numbers that are set, by the library's names.
    fn numbers(&self) -> Vec<(&str, f64)> {
        let flag = |set: bool| set.then(|| 1.0);
        let fields = [
            ("weber_fraction", self.weber_fraction),
            ("floor_n", self.floor_n),
            ("multiplier", self.multiplier),
            ("rate_hz", self.rate_hz),
            ("axes", Some(self.axes as f64)),
            ("position_share", self.position_share),
            ("announced", flag(self.announced)),
            ("predicted", flag(self.predicted)),
        ];
        let set = fields.iter().filter_map(|(name, value)| value.map(|value| (*name, value)));
        set.chain(self.parameters.iter().map(|(name, value)| (name.as_str(), *value))).collect()
    }
}

/// Where a master's session stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It asks for a session.
    Connecting,
    /// Positions are answered.
    Established,
    /// There has been no answer for 200 ms; the force fades.
    Stale,
    /// It says goodbye.
    Closing,
    /// It is over.
    Closed,
}

/// A master. Each period, call `tick`, `force` and then `send` until that returns `None`; after `receive`, send too.
pub struct Master {
    node: NonNull<sys::Master>,
    axes: usize,
    _source: Source, // the node points to it
}

// Safety: a node has no ties to a thread, and its source of random numbers is Send.
unsafe impl Send for Master {}

impl Master {
    /// Make a master; `random` is libcrypto's unless it is given.
    pub fn new(request: &Request, random: Option<Random>) -> Result<Master, Error> {
        let mut source = Source::new(random);
        let numbers = request.numbers();
        let names =
            numbers.iter().map(|(name, _)| c_text(name, "a parameter")).collect::<Result<Vec<CString>, Error>>()?;
        let pointers: Vec<*const c_char> = names.iter().map(|name| name.as_ptr()).collect();
        let values: Vec<f64> = numbers.iter().map(|(_, value)| *value).collect();
        let (codec, name) = (c_text(&request.codec, "the codec")?, c_text(&request.name, "the name")?);
        // Safety: the texts and arrays live until it returns, and the source lives as long as the node.
        let node = made(|wrong| unsafe {
            sys::hn_make_master(
                codec.as_ptr(),
                name.as_ptr(),
                pointers.as_ptr(),
                values.as_ptr(),
                values.len(),
                draw,
                source.context(),
                wrong,
            )
        })?;
        Ok(Master { node, axes: request.axes, _source: source })
    }

    /// Ask for sealed sessions only. Call it before the first tick.
    pub fn seal(&mut self, key: &PrivateKey, slave_public: &Key) -> Result<(), Error> {
        let psk = if key.psk == [0; 32] { null() } else { key.psk.as_ptr() };
        // Safety: keys have 32 bytes, and are copied.
        check(unsafe { sys::hn_seal_master(self.node.as_ptr(), key.own.as_ptr(), slave_public.as_ptr(), psk) })
    }

    /// Give the position of this period. `None`: nothing is sent but what the session needs.
    ///
    /// # Panics
    ///
    /// If it has fewer elements than the request has axes.
    pub fn tick(&mut self, position_m: Option<&[f64]>, now_us: i64) {
        assert!(position_m.map_or(true, |position| position.len() >= self.axes), "a position needs each axis");
        let position = position_m.map_or(null(), |position| position.as_ptr());
        // Safety: it reads one element for each axis.
        unsafe { sys::hn_master_tick(self.node.as_ptr(), position, now_us) }
    }

    /// Return the force to apply now. Limit it to what the device and a finger can bear.
    pub fn force(&mut self, now_us: i64) -> Vector {
        let mut force_n = [0.0; MOST_AXES];
        // Safety: it writes one element for each axis, at most MOST_AXES.
        unsafe { sys::hn_master_force(self.node.as_ptr(), force_n.as_mut_ptr(), now_us) };
        force_n
    }

    /// Return the next datagram for the slave.
    pub fn send(&mut self) -> Option<Datagram> {
        // Safety: it writes at most DATAGRAM_BYTES.
        Datagram::written(|bytes| unsafe { sys::hn_master_send(self.node.as_ptr(), bytes) })
    }

    /// Take in a datagram. A bad one is counted and dropped.
    pub fn receive(&mut self, datagram: &[u8], now_us: i64) {
        // Safety: it reads that many bytes.
        unsafe { sys::hn_master_receive(self.node.as_ptr(), datagram.as_ptr().cast(), datagram.len(), now_us) }
    }

    /// End the session. Then go on until the state is `Closed`, which takes at most 250 ms.
    pub fn close(&mut self, reason: &str, now_us: i64) {
        let reason = CString::new(reason.replace('\0', "")).expect("no zero is left");
        // Safety: the reason is copied.
        unsafe { sys::hn_master_close(self.node.as_ptr(), reason.as_ptr(), now_us) }
    }

    /// Return where the session stands.
    pub fn state(&self) -> State {
        match unsafe { sys::hn_master_state(self.node.as_ptr()) } {
            0 => State::Connecting,
            1 => State::Established,
            2 => State::Stale,
            3 => State::Closing,
            _ => State::Closed,
        }
    }

    /// Return why the slave refused, closed or warned, newest first, and its code; 0 and nothing if it has not.
    pub fn reason(&self) -> (u32, String) {
        let mut code = 0;
        let text = text_of(unsafe { sys::hn_master_reason(self.node.as_ptr(), &mut code) });
        (code, text.unwrap_or_default())
    }

    /// Return the name of the slave's scene; empty before the first session.
    pub fn scene(&self) -> String {
        text_of(unsafe { sys::hn_master_scene(self.node.as_ptr()) }).unwrap_or_default()
    }

    /// Return how many datagrams were dropped.
    pub fn counts(&self) -> Counts {
        counted(|name| unsafe { sys::hn_master_count(self.node.as_ptr(), name) })
    }
}

impl Drop for Master {
    fn drop(&mut self) {
        // Safety: nobody else has the node.
        unsafe { sys::hn_free_master(self.node.as_ptr()) }
    }
}

//! Drives the crate by the lines of peers/conformance.

use std::io::{stdin, stdout, BufRead, Write};
use std::sync::{Arc, Mutex};

use hapticnet::{Counts, Datagram, Key, Listed, Master, PrivateKey, Random, Request, Slave, ADDRESS_BYTES, MOST_AXES};

type Answer = Result<String, String>;

fn bytes_of(text: &str) -> Result<Vec<u8>, String> {
    if text == "-" {
        return Ok(Vec::new());
    }
    let pairs = text.as_bytes().chunks(2).map(|pair| {
        let pair = std::str::from_utf8(pair).ok().filter(|pair| pair.bytes().all(|digit| digit.is_ascii_hexdigit()));
        pair.filter(|pair| pair.len() == 2).and_then(|pair| u8::from_str_radix(pair, 16).ok())
    });
    let bytes: Option<Vec<u8>> = pairs.collect();
    bytes.filter(|bytes| !bytes.is_empty()).ok_or_else(|| format!("'{}' is not pairs of hex digits", text))
}

fn hex(bytes: &[u8]) -> String {
    let text: String = bytes.iter().map(|byte| format!("{:02x}", byte)).collect();
    if text.is_empty() {
        "-".into()
    } else {
        text
    }
}

fn sent(datagram: Option<Datagram>) -> String {
    datagram.map_or("-".into(), |datagram| hex(&datagram))
}

fn real(text: &str) -> Result<f64, String> {
    let bytes: Result<[u8; 8], _> = bytes_of(text)?.try_into();
    bytes.map(f64::from_be_bytes).map_err(|_| format!("'{}' is not the 16 hex digits of a float", text))
}

fn text_of(hex: &str) -> Result<String, String> {
    String::from_utf8(bytes_of(hex)?).map_err(|_| "it is not UTF-8".into())
}

fn integer<T: std::str::FromStr>(text: &str) -> Result<T, String> {
    text.parse().map_err(|_| format!("'{}' is not an integer", text))
}

fn key(hex: &str) -> Result<Key, String> {
    let bytes = bytes_of(hex)?;
    if bytes.is_empty() {
        return Ok([0; 32]);
    }
    bytes.try_into().map_err(|_| "a key has 32 bytes".into())
}

fn counts(counts: Counts) -> String {
    format!("{} {} {}", counts.malformed, counts.stray, counts.too_old)
}

fn features() -> String {
    let takes = |request: Request| Master::new(&request, None).is_ok();
    let has = |codec: &str| takes(Request { codec: codec.into(), ..Request::default() });
    // Like the codecs that follow the hand, hapticnet's master bounds velocity-adaptive: without that, they differ.
    let bounded = |codec: &str| codec != "velocity-adaptive" || has("motion-predictive");
    let codecs = hapticnet::codecs().into_iter().filter(|codec| has(codec) && bounded(codec));
    let codecs = codecs.collect::<Vec<_>>().join(",");
    let keys = [
        ("share", Request { position_share: Some(0.25), ..Request::default() }),
        ("announced", Request { announced: true, ..Request::default() }),
        ("predicted", Request { predicted: true, ..Request::default() }),
    ];
    let also: Vec<&str> = keys.into_iter().filter(|(_, request)| takes(request.clone())).map(|(key, _)| key).collect();
    let also = if also.is_empty() { "-".into() } else { also.join(",") };
    let rest = "slave_codecs=deadband,raw sealed=master,slave";
    format!("language=Rust roles=master,slave codecs={} axes={} {} also={}", codecs, MOST_AXES, rest, also)
}

enum Node {
    None,
    Master(Master),
    Slave(Slave),
}

struct Adapter {
    words: Arc<Mutex<(Vec<u32>, usize)>>,
    axes: usize,
    node: Node,
}

impl Adapter {
    fn random(&self) -> Option<Random> {
        let words = Arc::clone(&self.words);
        Some(Box::new(move || {
            let (words, at) = &mut *words.lock().expect("one thread");
            let word = words.get(*at).copied().unwrap_or(0);
            *at = (*at + 1).min(words.len().saturating_sub(1));
            word
        }))
    }

    fn run(&mut self, fields: &[&str]) -> Answer {
        let field = |i: usize| fields.get(i).copied().ok_or_else(|| "a field is missing".to_string());
        match field(0)? {
            "features" => Ok(features()),
            "random" => {
                let bytes = bytes_of(field(1)?)?;
                if bytes.is_empty() || bytes.len() % 4 != 0 {
                    return Err("random takes words of 4 bytes".into());
                }
                let words = bytes.chunks(4).map(|word| u32::from_be_bytes(word.try_into().expect("4 bytes")));
                *self.words.lock().expect("one thread") = (words.collect(), 0);
                Ok(String::new())
            }
            "master" => self.make_master(&fields[1..]),
            "slave" => self.make_slave(&fields[1..]),
            command => self.run_node(command, fields),
        }
    }

    fn make_master(&mut self, fields: &[&str]) -> Answer {
        let mut request = Request::default();
        if fields.len() < 7 {
            return Err("a key of master is missing".into());
        }
        for field in fields {
            let (name, value) = field.split_once('=').ok_or("a key has no value")?;
            match name {
                "codec" => request.codec = value.into(),
                "name" => request.name = text_of(value)?,
                "axes" => request.axes = integer(value)?,
                "rate" => request.rate_hz = Some(real(value)?),
                "weber" => request.weber_fraction = Some(real(value)?),
                "floor" => request.floor_n = Some(real(value)?),
                "multiplier" => request.multiplier = Some(real(value)?),
                "share" => request.position_share = Some(real(value)?),
                "announced" => request.announced = value == "1",
                "predicted" => request.predicted = value == "1",
                _ => {
                    let name = name.strip_prefix("p.").ok_or_else(|| format!("'{}' is not a key of master", name))?;
                    request.parameters.push((name.into(), real(value)?));
                }
            }
        }
        self.node = Node::Master(Master::new(&request, self.random()).map_err(|error| error.to_string())?);
        self.axes = request.axes;
        Ok(String::new())
    }

    fn make_slave(&mut self, fields: &[&str]) -> Answer {
        let (mut scene, mut axes) = (None, None);
        for field in fields {
            match field.split_once('=') {
                Some(("scene", value)) => scene = Some(text_of(value)?),
                Some(("axes", value)) => axes = Some(integer(value)?),
                _ => return Err(format!("'{}' is not a key of slave", field)),
            }
        }
        let (scene, axes) = (scene.ok_or("the scene is missing")?, axes.ok_or("the axes are missing")?);
        self.node = Node::Slave(Slave::new(&scene, axes, self.random()).map_err(|error| error.to_string())?);
        self.axes = axes;
        Ok(String::new())
    }

    fn vector(&self, fields: &[&str]) -> Result<Vec<f64>, String> {
        if fields.len() != 2 + self.axes {
            return Err("a float for each axis is missing, or there are too many".into());
        }
        fields[2..].iter().map(|field| real(field)).collect()
    }

    fn run_node(&mut self, command: &str, fields: &[&str]) -> Answer {
        let field = |i: usize| fields.get(i).copied().ok_or_else(|| "a field is missing".to_string());
        let now_us = || integer::<i64>(field(1)?);
        let vector = self.vector(fields);
        let axes = self.axes;
        let floats = |vector: &[f64]| {
            let each: Vec<String> = vector[..axes].iter().map(|value| hex(&value.to_be_bytes())).collect();
            each.join(" ")
        };
        let done: Answer = Ok(String::new());
        match (&mut self.node, command) {
            (Node::Master(master), "tick") => {
                master.tick(Some(&vector?), now_us()?);
                done
            }
            (Node::Master(master), "force") => Ok(floats(&master.force(now_us()?))),
            (Node::Master(master), "send") => {
                let sent: Vec<String> = std::iter::from_fn(|| master.send()).map(|datagram| hex(&datagram)).collect();
                Ok(sent.join(" "))
            }
            (Node::Master(master), "receive") => {
                master.receive(&bytes_of(field(2)?)?, now_us()?);
                done
            }
            (Node::Master(master), "close") => {
                master.close(&text_of(field(2)?)?, now_us()?);
                done
            }
            (Node::Master(master), "state") => Ok(format!("{:?}", master.state()).to_lowercase()),
            (Node::Master(master), "reason") => {
                let (code, text) = master.reason();
                Ok(format!("{} {}", code, hex(text.as_bytes())))
            }
            (Node::Master(master), "scene") => Ok(hex(master.scene().as_bytes())),
            (Node::Master(master), "counts") => Ok(counts(master.counts())),
            (Node::Master(master), "seal") => {
                let own = PrivateKey::new(key(field(1)?)?, Some(key(field(3)?)?));
                master.seal(&own, &key(field(2)?)?).map_err(|error| error.to_string()).and(done)
            }
            (Node::Slave(slave), "receive") => {
                let (data, address) = (bytes_of(field(2)?)?, bytes_of(field(3)?)?);
                if address.is_empty() || address.len() > ADDRESS_BYTES {
                    return Err("an address has 1 to 28 bytes".into());
                }
                Ok(sent(slave.receive(&data, &address, now_us()?)))
            }
            (Node::Slave(slave), "position") => Ok(slave.position().map_or("-".into(), |position| floats(&position))),
            (Node::Slave(slave), "answer") => Ok(sent(slave.answer(&vector?, now_us()?))),
            (Node::Slave(slave), "close") => Ok(sent(slave.close(&text_of(field(2)?)?, integer(field(1)?)?))),
            (Node::Slave(slave), "address") => Ok(slave.master().map_or("-".into(), hex)),
            (Node::Slave(slave), "counts") => Ok(counts(slave.counts())),
            (Node::Slave(slave), "seal") => {
                let pairs = fields.get(2..).unwrap_or_default().chunks(2).map(|pair| {
                    let psk = pair.get(1).ok_or("a key is missing")?;
                    Ok(Listed { public: key(pair[0])?, psk: key(psk)? })
                });
                let listed = pairs.collect::<Result<Vec<Listed>, String>>()?;
                let own = PrivateKey::new(key(field(1)?)?, None);
                slave.seal(&own, &listed).map_err(|error| error.to_string()).and(done)
            }
            _ => Err(format!("there is no command '{}' now", command.escape_debug())),
        }
    }
}

fn main() {
    let mut adapter = Adapter { words: Arc::default(), axes: 1, node: Node::None };
    for line in stdin().lock().split(b'\n') {
        let line = String::from_utf8_lossy(&line.expect("stdin can be read")).into_owned();
        let fields: Vec<&str> = line.split(' ').collect();
        let answer = match adapter.run(&fields) {
            Ok(answer) if answer.is_empty() => "ok".into(),
            Ok(answer) => format!("ok {}", answer),
            Err(wrong) => format!("error {}", wrong),
        };
        let mut out = stdout().lock();
        writeln!(out, "{}", answer).and_then(|()| out.flush()).expect("stdout can be written");
    }
}

// Drives the C# binding by the lines of peers/conformance.
using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Text;
using Hapticnet;

internal sealed class Adapter
{
    private readonly byte[] _datagram = new byte[Node.DatagramBytes];
    private readonly double[] _vector = new double[3];
    private byte[] _random = new byte[4];
    private int _word;
    private int _axes = 1;
    private Master _master;
    private Slave _slave;

    private static void Main()
    {
        var adapter = new Adapter();
        var input = new StreamReader(Console.OpenStandardInput(), Encoding.ASCII);
        var output = new StreamWriter(Console.OpenStandardOutput(), new ASCIIEncoding()) { AutoFlush = true };
        output.NewLine = "\n";
        for (string line = input.ReadLine(); line != null; line = input.ReadLine())
        {
            string answer;
            try
            {
                string done = adapter.Run(line.Split(' '));
                answer = done.Length > 0 ? "ok " + done : "ok";
            }
            catch (HapticException error)
            {
                answer = "error " + error.Message;
            }
            catch (Exception error) // such as of a field that is missing
            {
                answer = "error " + error.GetType().Name + ": " + error.Message.Replace('\n', ' ');
            }
            output.WriteLine(answer);
        }
    }

    private static byte[] BytesOf(string text)
    {
        if (text == "-")
            return new byte[0];
        if (text.Length == 0 || text.Length % 2 != 0)
            throw new HapticException("'" + text + "' is not pairs of hex digits");
        var bytes = new byte[text.Length / 2];
        for (int i = 0; i < bytes.Length; i++)
            bytes[i] = byte.Parse(text.Substring(2 * i, 2), NumberStyles.AllowHexSpecifier);
        return bytes;
    }

    private static string Hex(byte[] bytes, int size)
    {
        var text = new StringBuilder();
        for (int i = 0; i < size; i++)
            text.Append(bytes[i].ToString("x2"));
        return size > 0 ? text.ToString() : "-";
    }

    private static string HexOf(string text)
    {
        byte[] bytes = Encoding.UTF8.GetBytes(text);
        return Hex(bytes, bytes.Length);
    }

    private static string TextOf(string hex)
    {
        return Encoding.UTF8.GetString(BytesOf(hex));
    }

    private static double Real(string text)
    {
        if (text.Length != 16)
            throw new HapticException("'" + text + "' is not the 16 hex digits of a float");
        return BitConverter.Int64BitsToDouble(long.Parse(text, NumberStyles.AllowHexSpecifier));
    }

    private static string TextOf(double value)
    {
        return BitConverter.DoubleToInt64Bits(value).ToString("x16");
    }

    private static long Integer(string text)
    {
        return long.Parse(text, NumberStyles.AllowLeadingSign, CultureInfo.InvariantCulture);
    }

    private static byte[] Key(string hex)
    {
        return hex == "-" ? null : BytesOf(hex);
    }

    private static string TextOf(Counts counts)
    {
        return counts.Malformed + " " + counts.Stray + " " + counts.TooOld;
    }

    private static string Features()
    {
        var codecs = new List<string>();
        foreach (string codec in Node.Codecs)
        {
            if (Takes(new Request { Codec = codec }))
                codecs.Add(codec);
        }
        // Like the codecs that follow the hand, hapticnet's master bounds this one: without that, they differ.
        if (!codecs.Contains("motion-predictive"))
            codecs.Remove("velocity-adaptive");
        var also = new List<string>();
        if (Takes(new Request { PositionShare = 0.25 }))
            also.Add("share");
        if (Takes(new Request { Announced = true }))
            also.Add("announced");
        if (Takes(new Request { Predicted = true }))
            also.Add("predicted");
        return "language=C# roles=master,slave codecs=" + string.Join(",", codecs)
            + " slave_codecs=deadband,raw sealed=master,slave axes=3 also="
            + (also.Count > 0 ? string.Join(",", also) : "-");
    }

    private static bool Takes(Request request)
    {
        try
        {
            new Master(request).Dispose();
            return true;
        }
        catch (HapticException)
        {
            return false;
        }
    }

    private string Run(string[] fields)
    {
        switch (fields[0])
        {
            case "features":
                return Features();
            case "random":
                byte[] words = BytesOf(fields[1]);
                if (words.Length == 0 || words.Length % 4 != 0)
                    throw new HapticException("random takes words of 4 bytes");
                _random = words;
                _word = 0;
                return "";
            case "master":
                return MakeMaster(fields);
            case "slave":
                return MakeSlave(fields);
        }
        if (_master != null)
            return RunMaster(fields);
        if (_slave != null)
            return RunSlave(fields);
        throw new HapticException("there is no node, or no such command");
    }

    private uint Random()
    {
        int at = 4 * _word;
        if (at + 4 < _random.Length)
            _word++;
        return (uint)_random[at] << 24 | (uint)_random[at + 1] << 16 | (uint)_random[at + 2] << 8 | _random[at + 3];
    }

    private void Use(Master master, Slave slave, int axes)
    {
        if (_master != null)
            _master.Dispose();
        if (_slave != null)
            _slave.Dispose();
        _master = master;
        _slave = slave;
        _axes = axes;
    }

    private string MakeMaster(string[] fields)
    {
        var request = new Request();
        if (fields.Length < 8)
            throw new HapticException("a key of master is missing");
        for (int i = 1; i < fields.Length; i++)
        {
            int equals = fields[i].IndexOf('=');
            string key = fields[i].Substring(0, equals), value = fields[i].Substring(equals + 1);
            if (key == "codec")
                request.Codec = value;
            else if (key == "name")
                request.Name = TextOf(value);
            else if (key == "axes")
                request.Axes = (int)Integer(value);
            else if (key == "rate")
                request.RateHz = Real(value);
            else if (key == "weber")
                request.WeberFraction = Real(value);
            else if (key == "floor")
                request.FloorN = Real(value);
            else if (key == "multiplier")
                request.Multiplier = Real(value);
            else if (key == "share")
                request.PositionShare = Real(value);
            else if (key == "announced")
                request.Announced = value == "1";
            else if (key == "predicted")
                request.Predicted = value == "1";
            else if (key.StartsWith("p.", StringComparison.Ordinal))
                request.Parameters[key.Substring(2)] = Real(value);
            else
                throw new HapticException("'" + key + "' is not a key of master");
        }
        Use(new Master(request, Random), null, request.Axes);
        return "";
    }

    private string MakeSlave(string[] fields)
    {
        string scene = "";
        int axes = 1;
        if (fields.Length != 3)
            throw new HapticException("slave has two keys, scene and axes");
        for (int i = 1; i < fields.Length; i++)
        {
            if (fields[i].StartsWith("scene=", StringComparison.Ordinal))
                scene = TextOf(fields[i].Substring(6));
            else if (fields[i].StartsWith("axes=", StringComparison.Ordinal))
                axes = (int)Integer(fields[i].Substring(5));
            else
                throw new HapticException("'" + fields[i] + "' is not a key of slave");
        }
        Use(null, new Slave(scene, axes, Random), axes);
        return "";
    }

    private double[] Vector(string[] fields)
    {
        if (fields.Length != 2 + _axes)
            throw new HapticException("a float for each axis is missing, or there are too many");
        for (int i = 0; i < _axes; i++)
            _vector[i] = Real(fields[2 + i]);
        return _vector;
    }

    private string TextOfVector()
    {
        string text = TextOf(_vector[0]);
        for (int i = 1; i < _axes; i++)
            text += " " + TextOf(_vector[i]);
        return text;
    }

    private string RunMaster(string[] fields)
    {
        byte[] data;
        switch (fields[0])
        {
            case "tick":
                _master.Tick(Vector(fields), Integer(fields[1]));
                return "";
            case "force":
                _master.Force(_vector, Integer(fields[1]));
                return TextOfVector();
            case "send":
                var sent = new List<string>();
                for (int size = _master.Send(_datagram); size > 0; size = _master.Send(_datagram))
                    sent.Add(Hex(_datagram, size));
                return string.Join(" ", sent);
            case "receive":
                data = BytesOf(fields[2]);
                _master.Receive(data, data.Length, Integer(fields[1]));
                return "";
            case "close":
                _master.Close(TextOf(fields[2]), Integer(fields[1]));
                return "";
            case "state":
                return _master.State.ToString().ToLowerInvariant();
            case "reason":
                return _master.ReasonCode + " " + HexOf(_master.Reason);
            case "scene":
                return HexOf(_master.Scene);
            case "counts":
                return TextOf(_master.Counts);
            case "seal":
                using (var key = new PrivateKey(Key(fields[1]), Key(fields[3])))
                    _master.Seal(key, Key(fields[2]));
                return "";
            default:
                throw new HapticException("a master has no command '" + fields[0] + "'");
        }
    }

    private string RunSlave(string[] fields)
    {
        byte[] data;
        switch (fields[0])
        {
            case "receive":
                data = BytesOf(fields[2]);
                byte[] address = BytesOf(fields[3]);
                long now_us = Integer(fields[1]);
                return Hex(_datagram, _slave.Receive(data, data.Length, address, address.Length, now_us, _datagram));
            case "position":
                return _slave.Position(_vector) ? TextOfVector() : "-";
            case "answer":
                return Hex(_datagram, _slave.Answer(Vector(fields), Integer(fields[1]), _datagram));
            case "close":
                return Hex(_datagram, _slave.Close(TextOf(fields[2]), (int)Integer(fields[1]), _datagram));
            case "address":
                data = _slave.MasterAddress;
                return data == null ? "-" : Hex(data, data.Length);
            case "counts":
                return TextOf(_slave.Counts);
            case "seal":
                var masters = new List<ListedMaster>();
                for (int i = 2; i < fields.Length; i += 2)
                    masters.Add(new ListedMaster(Key(fields[i]), Key(fields[i + 1])));
                using (var key = new PrivateKey(Key(fields[1])))
                    _slave.Seal(key, masters);
                return "";
            default:
                throw new HapticException("a slave has no command '" + fields[0] + "'");
        }
    }
}

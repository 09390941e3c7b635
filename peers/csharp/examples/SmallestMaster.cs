// A master that moves in and out of a scene for five seconds, and prints what a hand would feel.
// First: hapticnet slave --scene paper. Then: SmallestMaster.exe [HOST [PORT [SECONDS]]]
using System;
using Hapticnet;

internal sealed class Needle : IHand
{
    private readonly long _startUs = Node.NowUs;
    private readonly double _seconds;
    private double _depthM;
    private int _tick;

    internal Needle(double seconds) => _seconds = seconds;

    public void Read(double[] positionM) =>
        positionM[0] = _depthM = 0.015 * (1.0 - Math.Cos(2e-6 * Math.PI * (Node.NowUs - _startUs) / _seconds));

    public void Apply(double[] forceN)
    {
        if (_tick++ % 100 == 0)
            Console.WriteLine("{0:0.00} mm {1:0.00} N", _depthM * 1e3, forceN[0]); // where a device would be pushed
    }
}

internal static class SmallestMaster
{
    private static int Main(string[] arguments)
    {
        string host = arguments.Length > 0 ? arguments[0] : "127.0.0.1";
        int port = 47800;
        double seconds = 5.0;
        try
        {
            if ((arguments.Length > 1 && !int.TryParse(arguments[1], out port)) || (arguments.Length > 2
                && !double.TryParse(arguments[2], out seconds)) || !(seconds > 0.0 && seconds < 1e6))
                throw new HapticException("usage: SmallestMaster.exe [HOST [PORT [SECONDS]]]");
            using (var link = new MasterLink(host, port, new Request { Name = "smallest" }, new Needle(seconds)))
            {
                System.Threading.Thread.Sleep((int)(seconds * 1e3));
                Console.WriteLine("{0} {1} {2}", link.State, link.Scene, link.Reason);
            }
        }
        catch (HapticException error)
        {
            Console.Error.WriteLine(error.Message);
            return 2;
        }
        return 0;
    }
}
